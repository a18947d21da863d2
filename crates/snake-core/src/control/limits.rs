//! Limits that a caller sets on one call, such as a server on the clouds of its clients.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};
use snake_geometry::options;

options! {
    /// The most that one call may ask of the machine, set with [`Control::limits`](crate::Control::limits). A call that would
    /// exceed a limit is refused before it begins.
    pub struct Limits {
        /// Points of a cloud, those that are not finite included.
        max_points, with_max_points: Option<usize> = None, none "only the limits that hold for every call";
        /// Bytes of the feature volumes of a field, one for each rotation. The U-Net needs about four volumes more while it
        /// encodes one. Of a scene they are known once its blocks are counted, before they are made.
        max_volume_bytes, with_max_volume_bytes: Option<usize> = None, none "only the limits that hold for every call";
        /// Evaluations of the decoders: for detection the queries times the refinement steps and one, times
        /// the rotations; for a mesh the samples of its grid times the rotations. Of a scene each cell with points is a query:
        /// they are known once it is encoded.
        max_evaluations, with_max_evaluations: Option<usize> = None, none "only the limits that hold for every call";
    }
}

impl Limits {
    pub(crate) fn check_points(&self, number: usize) -> Result<()> {
        check("points", number, self.max_points)
    }

    pub(crate) fn check_volume_bytes(&self, number: usize) -> Result<()> {
        check("bytes of feature volumes", number, self.max_volume_bytes)
    }

    /// For a product of these factors.
    pub(crate) fn check_evaluations(&self, factors: &[usize]) -> Result<()> {
        let number = factors.iter().copied().fold(1, usize::saturating_mul);
        check("evaluations", number, self.max_evaluations)
    }
}

fn check(what: &'static str, number: usize, limit: Option<usize>) -> Result<()> {
    match limit {
        Some(limit) if number > limit => Err(Error::LimitExceeded { what, number, limit }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::tests::cylinder;
    use crate::network::check;
    use crate::{Builtin, Control, DetectOptions, MeshOptions, Model, Options};

    fn refused<T>(result: Result<T>) -> Option<(&'static str, usize, usize)> {
        match result {
            Ok(_) => None,
            Err(Error::LimitExceeded { what, number, limit }) => Some((what, number, limit)),
            Err(error) => panic!("{error}"),
        }
    }

    #[test]
    fn a_scene_counts_the_bytes_of_its_volume() {
        let (points, _) = cylinder();
        let model = Model::builtin(Builtin::Scenes);
        let encode = |limit: usize| {
            let limits = Limits::default().with_max_volume_bytes(Some(limit));
            model.encode_with(&points, &model.recommended().encode, &Control::new().limits(limits))
        };
        let Some(("bytes of feature volumes", needed, 1000)) = refused(encode(1000)) else { panic!("not refused") };
        assert!(encode(needed).unwrap().volume().values.len() * size_of::<f32>() <= needed);
        assert_eq!(refused(encode(needed - 1)), Some(("bytes of feature volumes", needed, needed - 1)));
    }

    #[test]
    fn a_scene_counts_a_query_for_each_cell_with_points() {
        let (points, _) = cylinder();
        let model = Model::builtin(Builtin::Scenes);
        let options = *model.recommended();
        let detect = |limit: Option<usize>| {
            let limits = Limits::default().with_max_evaluations(limit);
            model.detect_with(&points, &options, &Control::new().limits(limits))
        };
        let queries = detect(None).unwrap().counts.queries;
        let needed = queries * (options.detect.refine_steps + 1);
        assert!(queries > 100 && queries < points.len());
        assert_eq!(refused(detect(Some(needed))), None);
        assert_eq!(refused(detect(Some(needed - 1))), Some(("evaluations", needed, needed - 1)));
    }

    #[test]
    fn calls_above_a_limit_are_refused_and_calls_at_it_run() {
        let (points, field) = cylinder();
        let model = Model::builtin(Builtin::Compact);
        let detect = DetectOptions::default().with_query_resolution(16).with_refine_steps(2);
        let mut options = Options::default().with_detect(detect);
        options.encode.rotations = 2;
        let volumes = check::volume_bytes(model.config(), 2);
        let with = |limits| Control::new().limits(limits);
        let in_model = |limits| refused(model.detect_with(&points, &options, &with(limits)));
        let limits = Limits::default();
        for (name, needed, limited) in [
            ("points", 2000, Limits::with_max_points as fn(Limits, Option<usize>) -> Limits),
            ("bytes of feature volumes", volumes, Limits::with_max_volume_bytes),
            ("evaluations", 16 * 16 * 16 * 3 * 2, Limits::with_max_evaluations),
        ] {
            assert_eq!(in_model(limited(limits, Some(needed))), None, "{name}");
            assert_eq!(in_model(limited(limits, Some(needed - 1))), Some((name, needed, needed - 1)));
        }
        let in_field = |limit| refused(field.detect_with(&detect, &with(limits.with_max_evaluations(Some(limit)))));
        assert_eq!((in_field(12288), in_field(12287)), (None, Some(("evaluations", 12288, 12287))));
        let mesh = MeshOptions::default().with_resolution(16);
        let in_mesh = |limit| refused(field.mesh_with(&mesh, &with(limits.with_max_evaluations(Some(limit)))));
        assert_eq!((in_mesh(4096), in_mesh(4095)), (None, Some(("evaluations", 4096, 4095))));
    }
}

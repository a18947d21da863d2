//! Registration of many scans to one map.

use std::time::Instant;

use snake_core::{Cloud, Control, Error, Model, Result};

use super::tries::{Effort, Search};
use crate::options::{PairOptions, RegisterOptions, check_viewpoint, place_viewpoint};
use crate::result::Registration;
use crate::steps::{Lengths, Pair, PreparedCloud, prepare};

/// Maximum number of keypoints of a map. With it, 23 of 25 scans are right in 2.2 times the time of a pair. With
/// 16 000 keypoints it is 22 scans in 1.9 times, with 40 000 it is 23 in 3.3, and with all of them 22 in 5.4.
const KEYPOINTS: usize = 20_000;

/// A map to which scans are registered, such as a floor of rooms or a street. Its voxels, normals and
/// descriptors are computed once and kept.
pub struct PreparedMap {
    prepared: PreparedCloud,
    origin: [f64; 3],
    model: Option<Model>,
    options: RegisterOptions,
}

impl PreparedMap {
    /// Prepares a map `(M, 3)`. `viewpoint` is the sensor's position in the map's frame, if a single
    /// sensor saw the whole map.
    ///
    /// `voxel_size` is required: it depends on the size of the scans, which the map does not show.
    /// [`register`](super::register()) takes 1/80 of a scan's diameter. `max_keypoints` applies to scans;
    /// a map has up to 20 000.
    ///
    /// # Errors
    /// [`Error::Option`] without a voxel size; the errors of [`prepare`](crate::steps::prepare()).
    pub fn new(
        map: &Cloud,
        viewpoint: Option<[f64; 3]>,
        model: Option<&Model>,
        options: &RegisterOptions,
        control: &Control,
    ) -> Result<Self> {
        options.check_ranges()?;
        if options.voxel_size.is_none() {
            let allowed = "a length for a map, such as 1/80 of the diameter of its scans";
            return Err(Error::Option { name: "voxel_size", value: "none".into(), allowed });
        }
        check_viewpoint("viewpoint", viewpoint)?;
        let viewpoints = [place_viewpoint(viewpoint, map.origin)];
        // The seed of a pair's target. With the source's seed, equal clouds would have equal random keypoints.
        let map_options = options.with_seed(options.seed.wrapping_add(1)).with_max_keypoints(KEYPOINTS);
        let model = options.model_to_run(model)?;
        let prepared = prepare(&[&map.points], &viewpoints, model, &map_options, control)?.clouds.remove(0);
        Ok(Self { prepared, origin: map.origin, model: model.cloned(), options: *options })
    }

    /// The lengths with which the map and the scans are prepared.
    pub fn lengths(&self) -> &Lengths {
        self.prepared.lengths()
    }

    /// Finds the transform from a scan `(N, 3)` to the map, as [`register`](super::register()) does
    /// with the lengths of the map.
    ///
    /// # Errors
    /// The errors of [`register_with`](super::register_with()); [`Error::Option`] also for a `target_viewpoint`,
    /// which belongs to [`PreparedMap::new`], and for `estimate_scale`, which would change the lengths.
    pub fn register(&self, scan: &Cloud, pair_options: &PairOptions, control: &Control) -> Result<Registration> {
        let start = Instant::now();
        pair_options.check()?;
        let refused = |name, value: &str, allowed| Err(Error::Option { name, value: value.into(), allowed });
        if pair_options.target_viewpoint.is_some() {
            return refused("target_viewpoint", "a place", "none: that of the map was given with it");
        }
        if pair_options.estimate_scale {
            return refused("estimate_scale", "true", "false: the lengths of a map are fixed");
        }
        let (options, mut pair_options) = (&self.options, *pair_options);
        pair_options.place(scan.origin, self.origin);
        let (viewpoint, model) = (pair_options.source_viewpoint, self.model.as_ref());
        let prepared = PreparedCloud::new(&scan.points, viewpoint, self.lengths(), model, options, control)?;
        let pair = Pair::new(&prepared, &self.prepared, options.gravity);
        let search = Search::new(&pair, options, &pair_options, Effort::Thorough, control);
        let registration = search.register()?.between_origins(scan.origin, self.origin);
        Ok(Registration { seconds: start.elapsed().as_secs_f64(), ..registration })
    }
}

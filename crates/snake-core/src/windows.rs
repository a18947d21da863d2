//! Detection in windows: a large cloud as overlapping balls, each encoded by itself.

use std::num::NonZeroUsize;
use std::sync::Arc;

use rayon::prelude::*;

use crate::clock::Instant;
use crate::control::Control;
use crate::detect::{Candidates, Detection, finish};
use crate::field::{Field, check_number_of_points};
use crate::kd_tree::KdTree;
use crate::length::Length;
use crate::network::Network;
use crate::options::{Options, check_radius};
use crate::points::{FinitePoints, Normalization, NormalizationMethod, Point};
use crate::side_by_side::side_by_side;
use crate::window_cells::{WindowCells, has_more_windows};
use crate::{Error, Result};
use snake_kernels::Scratch;

/// Number of windows that every cloud may have, even with few points.
pub(crate) const FEW_WINDOWS: usize = 64;

/// Detects keypoints in windows of `radius`. Each window keeps the queries closest to its own centre. The candidates of
/// all windows are suppressed together, as in [`Field::detect`].
///
/// Windows are encoded in parallel, each on one thread, so there are at most as many volumes as threads.
pub(crate) fn detect_in_windows(
    network: &Arc<Network>,
    points: &[Point],
    radius: Length,
    options: &Options,
    control: &Control,
) -> Result<Detection> {
    let limits = control.get_limits();
    limits.check_points(points.len())?;
    limits.check_volumes(&network.config, options.encode.rotations)?;
    let finite = FinitePoints::of("points", points)?;
    let radius = radius.in_units("window_radius", &finite.points)?;
    check_radius(radius, || format!("{radius:e}"))?;
    let radius = radius as f32;
    let voxel_size = network.config.frame().map_or(0.0, |frame| frame.voxel_size(2.0 * radius));
    let radii = options.detect.radii(&finite.points, voxel_size)?;
    let sample = options.encode.sample(&finite.points);
    let encoded = sample.as_deref().unwrap_or(&finite.points);
    check_number_of_points(encoded.len())?;
    check_number_of_windows(encoded, radius)?;
    let windows = Windows::new(network, encoded, &finite.points, radius, options)?;
    let of_one_window = options.detect.evaluations(options.encode.rotations);
    limits.check_evaluations(&[&of_one_window[..], &[windows.cells.centers.len()]].concat())?;
    let counter = control.begin("windows", windows.cells.centers.len());
    let of_window = control.without_progress();
    let detect_in = |window: usize| {
        let found = windows.detect(window, &of_window)?;
        counter.add(1);
        Ok(found)
    };
    let start = Instant::now();
    let (mut candidates, mut occupancy) = (Candidates::default(), Vec::new());
    for (of_window, occupancy_of_window) in side_by_side(windows.cells.centers.len(), detect_in)? {
        candidates.append(of_window);
        occupancy.extend(occupancy_of_window);
    }
    candidates.timing.scale_to(start.elapsed().as_secs_f64());
    control.begin("suppression", 0).check()?;
    let of_kept =
        |kept: &[usize], _: &[Point]| Ok(Scratch::collect(kept.len(), kept.iter().map(|&index| occupancy[index])));
    let mut detection = finish(candidates, &finite, radii, &options.detect, of_kept, Vec::new())?;
    detection.num_skipped = points.len() - finite.points.len();
    detection.num_encoded = encoded.len();
    Ok(detection)
}

/// The windows of a cloud, which are detected one by one.
pub(crate) struct Windows<'a> {
    network: &'a Arc<Network>,
    options: &'a Options,
    radius: f32,
    pub(crate) cells: WindowCells<'a>,
    nearest_center: KdTree<f32>,
    /// The points to which keypoints are moved, if they are.
    snap: Option<(KdTree<f32>, &'a [Point])>,
}

impl<'a> Windows<'a> {
    /// The windows of the encoded points. `points` are those to which keypoints are moved.
    pub(crate) fn new(
        network: &'a Arc<Network>,
        encoded: &'a [Point],
        points: &'a [Point],
        radius: f32,
        options: &'a Options,
    ) -> Result<Self> {
        let cells = WindowCells::new(encoded, radius);
        let nearest_center = KdTree::new(&cells.centers)?;
        let snap = options.detect.snap.then(|| Ok::<_, Error>((KdTree::new(points)?, points))).transpose()?;
        Ok(Self { network, options, radius, cells, nearest_center, snap })
    }

    /// The candidates of one window with their occupancy.
    pub(crate) fn detect(&self, window: usize, control: &Control) -> Result<(Candidates, Vec<f32>)> {
        let start = Instant::now();
        let inside = self.cells.points_of(window);
        // A rounded centre may have no point within the radius if coordinates are coarser than the radius.
        if inside.is_empty() {
            return Ok(Default::default());
        }
        let normalization = Normalization { center: self.cells.centers[window], scale: 2.0 * self.radius };
        let field =
            Field::normalized(self.network.clone(), inside, normalization, self.options.encode.rotations, control)?;
        let seconds = start.elapsed().as_secs_f64();
        let owns = |position: &Point| self.nearest_center.nearest(position, NonZeroUsize::MIN)[0].0 == window;
        let mut found = Candidates::of(&field, &self.options.detect, owns, control)?.compact();
        found.timing.encode = seconds;
        // The occupancy at a keypoint is that of the window that keeps it.
        let occupancy = match &self.snap {
            Some((tree, points)) => {
                let nearest = |position: &Point| points[tree.nearest(position, NonZeroUsize::MIN)[0].0];
                field.occupancy(&found.positions.par_iter().map(nearest).collect::<Vec<_>>())?
            }
            None => field.occupancy(&found.positions)?,
        };
        Ok((found, occupancy))
    }
}

/// Refuses more windows than half the points: they would take hours for a large cloud, with almost no points each. Also
/// refuses extents whose squares vanish or overflow.
fn check_number_of_windows(points: &[Point], radius: f32) -> Result<()> {
    let extent = Normalization::of_finite(points, NormalizationMethod::UnitSphere)?.scale;
    let most = FEW_WINDOWS.max(points.len() / 2);
    if !has_more_windows(points, radius, most) {
        return Ok(());
    }
    let suggested = larger_radius(points, radius, extent);
    let reason = format!(
        "radius {radius} gives more than {most} windows for {} points, which is too many; {suggested} would be suitable \
         (`window_radius`)",
        points.len()
    );
    Err(Error::Input { what: "window_radius", reason })
}

/// The radius, to one digit, of windows with 16 points on average, or of a single window.
fn larger_radius(points: &[Point], radius: f32, extent: f32) -> f64 {
    let mut suggested = extent;
    while suggested / 2.0 > radius && !has_more_windows(points, suggested / 2.0, points.len() / 16) {
        suggested /= 2.0;
    }
    let digit = 10_f64.powf(f64::from(suggested).log10().floor());
    // The conversion goes through text, because a product with a power of ten has more digits.
    let rounded = (f64::from(suggested) / digit).ceil() * digit;
    format!("{rounded:.0e}").parse().unwrap_or(rounded)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Builtin, DetectOptions, Keypoint, Model};

    /// A plate of 6 by 4 with two posts on it.
    fn plate() -> Vec<Point> {
        let plate = (0..9600).map(|i| [(i % 120) as f32 * 0.05, (i / 120) as f32 * 0.05, 0.0]);
        let post = |x: f32, y: f32| {
            (0..800).map(move |i| {
                let angle = i as f32 * 0.7;
                [x + 0.1 * angle.cos(), y + 0.1 * angle.sin(), i as f32 * 1e-3]
            })
        };
        plate.chain(post(1.5, 1.0)).chain(post(4.5, 3.0)).collect()
    }

    fn preset(window_radius: f64) -> Options {
        let detect = DetectOptions { saliency_threshold: 0.0, max_keypoints: 200, ..Options::default().detect };
        Options {
            detect: DetectOptions { query_resolution: 24, refine_steps: 0, ..detect },
            window_radius: Some(Length::Units(window_radius)),
            ..Default::default()
        }
    }

    #[test]
    fn one_window_around_the_cloud_equals_its_field() {
        let points: Vec<Point> = plate().into_iter().skip(9600).take(800).collect();
        let model = Model::builtin(Builtin::Compact);
        for snap in [false, true] {
            let mut options = preset(5.0);
            options.detect.snap = snap;
            let found = model.detect(&points, &options).unwrap();
            let center = WindowCells::new(&points, 5.0).centers;
            let [center] = center[..] else { panic!("{center:?}") };
            let scaled: Vec<Point> =
                points.iter().map(|p| std::array::from_fn(|a| (p[a] - center[a]) / 10.0)).collect();
            options.window_radius = None;
            options.encode.normalization = NormalizationMethod::None;
            options.detect.nms_radius = Some(Length::Units(0.001));
            let alone = model.detect(&scaled, &options).unwrap();
            assert_eq!(found.counts, alone.counts);
            assert!(found.keypoints.len() > 3);
            for (a, b) in found.keypoints.iter().zip(&alone.keypoints) {
                assert_eq!(
                    (a.saliency, a.occupancy, a.nearest_index),
                    (b.saliency, b.occupancy, b.nearest_index),
                    "snap: {snap}"
                );
                assert!((0..3).all(|axis| (a.position[axis] - (b.position[axis] * 10.0 + center[axis])).abs() < 1e-5));
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let model = Model::builtin(Builtin::Compact);
        let points = plate();
        let mut options = preset(0.6);
        options.detect.query_resolution = 12;
        let found = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let Detection { keypoints, counts, .. } = pool.install(|| model.detect(&points, &options)).unwrap();
            (keypoints, counts)
        };
        let one = found(1);
        assert!(one.1.windows > 60 && one.0.len() > 20, "{:?}", one.1);
        for threads in [2, 3, 60] {
            assert_eq!(found(threads), one);
        }
    }

    #[test]
    fn more_windows_than_half_the_points_are_refused_with_a_suitable_radius() {
        let model = Model::builtin(Builtin::Compact);
        let points = plate();
        for radius in [1e-15, 1e-9, 0.03] {
            let error = model.detect(&points, &preset(radius)).unwrap_err().to_string();
            assert!(error.starts_with("window_radius: ") && error.contains("`window_radius`"), "{error}");
            let suggested = error.split("too many; ").last().and_then(|end| end.split(' ').next()).unwrap();
            let windows = WindowCells::new(&points, suggested.parse().unwrap()).centers.len();
            assert!((points.len() / 200..points.len() / 4).contains(&windows), "{error}: {windows}");
        }
    }

    /// A cloud that ends one window farther has the same keypoints.
    #[test]
    fn keypoints_depend_only_on_their_surroundings() {
        let model = Model::builtin(Builtin::Compact);
        let points = plate();
        // Cells of 0.8 along x: windows with centers below 2.4 see nothing beyond 3.4.
        let near: Vec<Point> = points.iter().filter(|p| p[0] < 4.0).copied().collect();
        let of = |points: &[Point]| -> Vec<Keypoint> {
            let mut options = preset(1.0);
            options.detect.max_keypoints = 1_000_000;
            let found = model.detect(points, &options).unwrap().keypoints;
            found.into_iter().filter(|k| k.position[0] < 1.6).collect()
        };
        let (whole, near) = (of(&points), of(&near));
        assert!(whole.len() > 20);
        assert_eq!(
            whole.iter().map(|k| k.position).collect::<Vec<_>>(),
            near.iter().map(|k| k.position).collect::<Vec<_>>()
        );
    }

    #[test]
    fn options_and_indices_are_as_without_windows() {
        let model = Model::builtin(Builtin::Compact);
        let mut points = plate();
        points.insert(0, [f32::NAN; 3]);
        let mut options = preset(1.5);
        options.detect.nms_radius = Some(Length::Units(0.3));
        options.detect.snap = true;
        options.encode.rotations = 2;
        options.encode.max_points = Some(5000);
        let found = model.detect(&points, &options).unwrap();
        assert_eq!((found.num_skipped, found.num_encoded), (1, 5000));
        assert!(found.keypoints.len() > 10);
        assert!(found.keypoints.iter().all(|k| points[k.nearest_index] == k.position));
        assert!(found.keypoints.is_sorted_by(|a, b| a.saliency >= b.saliency));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(|| model.detect(&points, &options)).unwrap().keypoints, found.keypoints);
        for wrong in [0.0, -1.0, f64::NAN, 1e-60, 1e-16, 1e16, 1e60] {
            let error = model.detect(&points, &preset(wrong)).unwrap_err();
            assert!(matches!(error, Error::Option { name: "window_radius", .. }), "{error}");
        }
        // One window for each point, and one for all; coordinates coarser than the radius.
        let few = &points[1..30];
        for (radius, windows) in [(1e-15, 29), (1e15, 1)] {
            assert_eq!(model.detect(few, &preset(radius)).unwrap().counts.windows, windows);
        }
        let far: Vec<Point> = few.iter().map(|p| p.map(|v| 1e8 + 64.0 * v)).collect();
        assert!(model.detect(&far, &preset(1.0)).is_ok());
        options.encode.rotations = 65;
        assert!(model.detect(&points, &options).unwrap_err().to_string().contains("rotations"));
        assert!(model.detect(&[[1e30, 0.0, 0.0], [0.0; 3]], &preset(1.0)).is_err());
        assert!(model.encode(&points, &Default::default()).unwrap().detect(&preset(1.0).detect).is_ok());
    }
}

//! Tiles of a hall against the whole.

use std::collections::BTreeSet;

use super::*;
use crate::lattice::lowest_corner;
use crate::{Builtin, Keypoint, Model};
use snake_geometry::resolution;

/// A strip of floor, 16 by 1.5, with walls and posts: it is longer than a tile with its halo.
fn hall() -> Vec<Point> {
    let floor = (0..9600).map(|i| [(i % 320) as f32 * 0.05 - 5.0, (i / 320) as f32 * 0.05, 0.0]);
    let wall =
        |x: f32| (0..900).map(move |i| [x + 0.01 * (i % 9) as f32, (i % 30) as f32 * 0.05, (i / 30) as f32 * 0.05]);
    let post = |i: u32| {
        let (at, angle) = (i / 400, i as f32 * 0.7);
        let [x, y] = [at as f32 * 1.3 - 4.5, 0.4 + 0.25 * (at % 3) as f32];
        [x + 0.1 * angle.cos(), y + 0.1 * angle.sin(), (i % 400) as f32 * 2e-3]
    };
    floor.chain(wall(-3.1)).chain(wall(1.0)).chain(wall(6.3)).chain((0..4400).map(post)).collect()
}

const VOXEL: f64 = 0.0625;

fn options(mode_radius: Option<Length>) -> Options {
    let mut options = *Model::builtin(Builtin::Scenes).recommended();
    options.encode.voxel_size = Some(VOXEL.into());
    options.detect = options.detect.with_saliency_threshold(0.01).with_nms_radius(Some(Length::Voxels(1.5)));
    options.detect = options.detect.with_mode_radius(mode_radius).with_max_keypoints(usize::MAX);
    options.detect.min_confidence = None;
    options
}

/// A detector of the tiles of a cloud.
fn detector_of(model: &Model, options: &Options, points: &[Point]) -> TileDetector {
    let mut detector = TileDetector::new(model, options).unwrap();
    let end = |end: fn(f32, f32) -> f32| points.iter().copied().reduce(|a, b| std::array::from_fn(|i| end(a[i], b[i])));
    detector.set_bounds([lowest_corner(points), end(f32::max).unwrap()]).unwrap();
    detector
}

/// The tiles of `side` columns with points, from `offset` on.
fn tiles(detector: &TileDetector, points: &[Point], side: i32, offset: i32) -> Vec<[Range<i32>; 2]> {
    let place = |point| detector.column(point).unwrap().map(|column| (column - offset).div_euclid(side));
    let places: BTreeSet<[i32; 2]> = points.iter().map(place).collect();
    let columns = |place: i32| place * side + offset..(place + 1) * side + offset;
    places.into_iter().map(|place| place.map(columns)).collect()
}

fn widen(columns: &[Range<i32>; 2], by: i32) -> [Range<i32>; 2] {
    columns.clone().map(|range| range.start - by..range.end + by)
}

/// The keypoints of all tiles with a halo, and their counts.
fn by_tiles(
    detector: &TileDetector,
    points: &[Point],
    tiles: &[[Range<i32>; 2]],
    halo: i32,
) -> (Vec<Candidate>, Counts) {
    let mut all = TileCandidates::default();
    for tile in tiles {
        let mut margin = detector.margin();
        let candidates = loop {
            let near = widen(tile, margin + halo);
            let near: Vec<Point> = points.iter().filter(|point| detector.is_in(point, &near)).copied().collect();
            let is_whole = margin > 99;
            if let Some(candidates) = detector.detect(&near, tile, margin, is_whole, &Control::default()).unwrap() {
                break candidates;
            }
            margin *= 2;
        };
        all.counts.add(&candidates.counts);
        all.candidates.extend(candidates.candidates);
    }
    let fates = detector.fates(&all.candidates, |_| true).unwrap();
    let fates = all.candidates.iter().zip(fates);
    let mut kept: Vec<Candidate> = fates.filter(|(_, fate)| *fate == Fate::Kept).map(|(c, _)| *c).collect();
    kept.sort_by(by_rank);
    (kept, all.counts)
}

fn is_equal(kept: &[Candidate], whole: &[Keypoint]) -> bool {
    kept.iter()
        .map(|c| (c.position, c.saliency, c.occupancy))
        .eq(whole.iter().map(|k| (k.position, k.saliency, k.occupancy)))
}

#[test]
fn tiles_of_any_size_give_the_bits_of_the_whole_cloud() {
    let model = Model::builtin(Builtin::Scenes);
    let points = hall();
    for (mode_radius, tilings) in [
        (None, &[(1, 0), (5, -2), (2, 1), (64, -29)][..]),
        (Some(Length::Resolutions(3.5)), &[(2, 1), (1, 0), (3, -1)]),
        // Chains of candidates and of modes that reach over several tiles.
        (Some(Length::Voxels(9.0)), &[(1, 0), (2, 0)]),
    ] {
        let options = options(mode_radius);
        let whole = model.detect(&points, &options).unwrap();
        assert!(whole.keypoints.len() > 50, "{}", whole.keypoints.len());
        let mut detector = detector_of(&model, &options, &points);
        detector.set_resolution(resolution("points", &points).unwrap()).unwrap();
        // `make test-full` tests all.
        let number = if std::env::var_os("SNAKE_FULL").is_some() { tilings.len() } else { 1 };
        for &(side, offset) in &tilings[..number] {
            let tiles = tiles(&detector, &points, side, offset);
            let (kept, counts) = by_tiles(&detector, &points, &tiles, detector.halo());
            assert!(is_equal(&kept, &whole.keypoints), "{side} {offset} {mode_radius:?}");
            let numbers = |counts: &Counts| [counts.queries, counts.occupied, counts.above_threshold];
            assert_eq!(numbers(&counts), numbers(&whole.counts));
        }
    }
}

#[test]
fn tiles_need_points_of_other_tiles() {
    let model = Model::builtin(Builtin::Scenes);
    let (points, options) = (hall(), options(None));
    let detector = detector_of(&model, &options, &points);
    assert_eq!((detector.column_side(), detector.margin()), (16.0 * VOXEL, 0));
    let whole = model.detect(&points, &options).unwrap();
    assert!(!is_equal(&by_tiles(&detector, &points, &tiles(&detector, &points, 1, 0), 0).0, &whole.keypoints));
}

#[test]
fn the_voxel_size_is_chosen_as_for_the_whole_cloud() {
    let model = Model::builtin(Builtin::Scenes);
    let mut options = options(None);
    options.encode.voxel_size = None;
    let mut detector = TileDetector::new(&model, &options).unwrap();
    assert!(detector.needs_voxel_size());
    detector.choose_voxel_size(&hall()).unwrap();
    assert!(!detector.needs_voxel_size());
    let whole = model.encode(&hall(), &options.encode).unwrap();
    assert_eq!(detector.options().encode.voxel_size, Some(Length::Units(whole.voxel_size().into())));
    assert!(detector.choose_voxel_size(&[[1.0; 3]; 9]).is_err());
}

#[test]
fn options_that_need_the_whole_cloud_are_refused_by_name() {
    let scenes = Model::builtin(Builtin::Scenes);
    let refused = |change: fn(&mut Options)| {
        let mut options = options(None);
        change(&mut options);
        TileDetector::new(&scenes, &options).err().map(|error| error.to_string()).unwrap_or_default()
    };
    for (name, error) in [
        ("`voxel_size` is 2r", refused(|options| options.encode.voxel_size = Some(Length::Resolutions(2.0)))),
        ("`nms_radius` is 10%", refused(|options| options.detect.nms_radius = Some(Length::Percent(10.0)))),
        ("`mode_radius` is 10%", refused(|options| options.detect.mode_radius = Some(Length::Percent(10.0)))),
        ("`max_points`", refused(|options| options.encode.max_points = Some(7))),
        ("`refine_steps`", refused(|options| options.detect.refine_steps = 3)),
        ("`snap`", refused(|options| options.detect.snap = true)),
        ("`prefer`", refused(|options| options.detect.prefer = Preference::Corners)),
    ] {
        assert!(error.contains(name), "{name}: {error}");
    }
    let compact = Model::builtin(Builtin::Compact);
    let error = TileDetector::new(&compact, &options(None)).unwrap_err().to_string();
    assert!(error.contains("scenes"), "{error}");
    let detector = TileDetector::new(&scenes, &options(None)).unwrap();
    assert!(detector.column(&[1e30, 0.0, 0.0]).unwrap_err().to_string().contains("voxel_size"));
}

#[test]
fn a_tile_that_is_too_large_names_what_fits() {
    let mut options = options(None);
    options.encode.voxel_size = Some(1e-3.into());
    let detector = TileDetector::new(&Model::builtin(Builtin::Scenes), &options).unwrap();
    let at = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1 << 24) as f32;
    let points: Vec<Point> = (0..200_000).map(|i| [at(i, 2_654_435_761), at(i, 40_503), at(i, 7919)]).collect();
    let error = detector.detect(&points, &[0..64, 0..64], 0, true, &Control::default()).unwrap_err().to_string();
    assert!(error.contains("smaller tile") && error.contains("times this size fits"), "{error}");
}

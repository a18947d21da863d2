//! Tile detectors refuse what they cannot use. `snake-tiles` compares the keypoints of tiles and of whole clouds.

use super::*;
use crate::{Builtin, Model};

fn options() -> Options {
    let mut options = *Model::builtin(Builtin::Scenes).recommended();
    options.encode.voxel_size = Some(0.0625.into());
    options.detect = options.detect.with_saliency_threshold(0.01).with_nms_radius(Some(Length::Voxels(1.5)));
    options.detect = options.detect.with_mode_radius(None).with_max_keypoints(usize::MAX);
    options.detect.min_confidence = None;
    options
}

#[test]
fn the_voxel_size_is_chosen_as_for_the_whole_cloud() {
    let model = Model::builtin(Builtin::Scenes);
    let mut options = options();
    options.encode.voxel_size = None;
    let floor: Vec<Point> = (0..9600).map(|i| [(i % 320) as f32 * 0.05 - 5.0, (i / 320) as f32 * 0.05, 0.0]).collect();
    let mut detector = TileDetector::new(&model, &options).unwrap();
    assert!(detector.needs_voxel_size() && detector.place([[0.0; 3], [1.0; 3]], None).is_err());
    detector.choose_voxel_size(&floor).unwrap();
    assert!(!detector.needs_voxel_size());
    let whole = model.encode(&floor, &options.encode).unwrap();
    assert_eq!(detector.options().encode.voxel_size, Some(Length::Units(whole.voxel_size().into())));
    assert!(detector.choose_voxel_size(&[[1.0; 3]; 9]).is_err());
}

#[test]
fn options_that_need_the_whole_cloud_are_refused_by_name() {
    let scenes = Model::builtin(Builtin::Scenes);
    let refused = |change: fn(&mut Options)| {
        let mut options = options();
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
    let error = TileDetector::new(&compact, &options()).unwrap_err().to_string();
    assert!(error.contains("scenes"), "{error}");
    let detector = TileDetector::new(&scenes, &options()).unwrap().place([[0.0; 3], [1.0; 3]], None).unwrap();
    assert!(detector.column(&[1e30, 0.0, 0.0]).unwrap_err().to_string().contains("voxel_size"));
}

#[test]
fn a_tile_that_is_too_large_names_what_fits() {
    let mut options = options();
    options.encode.voxel_size = Some(1e-3.into());
    let detector = TileDetector::new(&Model::builtin(Builtin::Scenes), &options).unwrap();
    let detector = detector.place([[0.0; 3], [1.0; 3]], None).unwrap();
    let at = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1 << 24) as f32;
    let points: Vec<Point> = (0..200_000).map(|i| [at(i, 2_654_435_761), at(i, 40_503), at(i, 7919)]).collect();
    let error = detector.detect(&points, &[0..64, 0..64], 0, true, &Control::default()).unwrap_err().to_string();
    assert!(error.contains("smaller tile") && error.contains("times this size fits"), "{error}");
}

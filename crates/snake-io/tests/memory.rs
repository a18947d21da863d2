//! The memory that reading and detection take per point.

mod messages;

use peak_alloc::PeakAlloc;
use snake_core::{Builtin, Model, Options, Point};
use snake_io::{ReadOptions, read_cloud, write_points};

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// The limit in bytes per point, without the cloud itself.
const BYTES_PER_POINT: usize = 60;

/// The peak of the memory in use while `work` runs, minus the memory in use before.
fn peak<T>(work: impl FnOnce() -> T) -> (T, usize) {
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    let result = work();
    (result, MEMORY.peak_usage().saturating_sub(before))
}

/// A torus, optionally with an outlier so far away that all other points share a few voxels.
fn cloud(num_points: usize, with_outlier: bool) -> Vec<Point> {
    let angle = |i: usize, turns: f64| (i as f64 * turns).rem_euclid(1.0) * std::f64::consts::TAU;
    let point = |i: usize| {
        let (u, v) = (angle(i, 0.618_033_988_7), angle(i, 0.754_877_666_2));
        let radius = 2.0 + 0.7 * v.cos();
        [radius * u.cos(), radius * u.sin(), 0.7 * v.sin()].map(|v| v as f32)
    };
    let mut points: Vec<Point> = (0..num_points).map(point).collect();
    if with_outlier {
        points[0] = [1e3, 0.0, 0.0];
    }
    points
}

/// Points of the two clouds that are compared; the difference does not count constant memory.
const SIZES: [usize; 2] = [100_000, 600_000];

fn bytes_per_point(peaks: [usize; 2]) -> usize {
    peaks[1].saturating_sub(peaks[0]) / (SIZES[1] - SIZES[0])
}

/// All cases are in one test, because all tests of a process share its memory.
#[test]
fn memory_grows_by_few_bytes_for_each_point() {
    let model = Model::builtin(Builtin::Compact);
    let mut many_keypoints = *model.recommended();
    many_keypoints.detect.max_keypoints = 1000;
    many_keypoints.detect.saliency_threshold = 0.0;
    for (name, options, with_outlier) in [
        ("as recommended", *model.recommended(), false),
        ("with an outlier", *model.recommended(), true),
        ("with 1000 keypoints", many_keypoints, false),
    ] {
        let detect = |options: &Options, points: &[Point]| model.detect(points, options).unwrap().counts.keypoints;
        let measure = |num_points| {
            let points = cloud(num_points, with_outlier);
            peak(|| detect(&options, &points)).1
        };
        measure(SIZES[0]);
        let bytes = bytes_per_point(SIZES.map(measure));
        assert!(bytes <= BYTES_PER_POINT, "{name}: {bytes} bytes a point");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.npy");
    let read = |num_points| {
        write_points(&path, &cloud(num_points, false), [0.0; 3]).unwrap();
        let (cloud, bytes) = peak(|| read_cloud(&path, &ReadOptions::default()).unwrap());
        assert_eq!(cloud.points.len(), num_points);
        bytes
    };
    // The file has 24 bytes a point, and the cloud 12.
    let bytes = bytes_per_point(SIZES.map(read));
    assert!(bytes <= 40, "reading: {bytes} bytes a point");
    recordings_take_the_memory_of_a_few_clouds(folder.path());
}

/// A recording of a thousand clouds of 12 kB.
fn recordings_take_the_memory_of_a_few_clouds(folder: &std::path::Path) {
    use mcap::records::MessageHeader;

    let message = [vec![0, 1, 0, 0], messages::encoded_points(true, &[[1.0; 4]; 760])].concat();
    let path = folder.join("long.mcap");
    let options = mcap::WriteOptions::new().compression(None);
    let mut writer = options.create(std::fs::File::create(&path).unwrap()).unwrap();
    let schema_id = writer.add_schema(messages::SCHEMA, "ros2msg", b"").unwrap();
    let channel_id = writer.add_channel(schema_id, "/a", "cdr", &Default::default()).unwrap();
    for time in 0..1000 {
        let header = MessageHeader { channel_id, sequence: time as u32, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, &message).unwrap();
    }
    writer.finish().unwrap();
    assert!(path.metadata().unwrap().len() > 12_000_000);
    let (number, bytes) = peak(|| snake_io::read_recording(&path, None).unwrap().map(Result::unwrap).count());
    assert!(number == 1000 && bytes < 5_000_000, "{number} clouds, {bytes} bytes");
}

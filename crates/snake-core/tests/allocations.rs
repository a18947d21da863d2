//! Memory that a detector allocates for each cloud. A test binary of its own, because its allocator counts for all threads.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use snake_core::{Builtin, Detection, Detector, Length, Model, Options, Point};

/// The allocator of the system, with counts.
struct Counting;

static NUMBER: AtomicUsize = AtomicUsize::new(0);
static BYTES: AtomicUsize = AtomicUsize::new(0);

// SAFETY: both functions hand their arguments to the allocator of the system.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        NUMBER.fetch_add(1, Relaxed);
        BYTES.fetch_add(layout.size(), Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A street of so many points: the road, two walls, and a box at `ahead`.
fn street(num_points: usize, ahead: f32) -> Vec<Point> {
    let point = |i: usize| {
        let (u, v) = ((i as f32 * 0.754_877_7).fract(), (i as f32 * 0.569_840_3).fract());
        match i % 4 {
            0 => [40.0 * u, 12.0 * v, 0.0],
            1 => [40.0 * u, 0.0, 6.0 * v],
            2 => [40.0 * u, 12.0, 6.0 * v],
            _ => [ahead + 4.0 * u, 5.0 + 2.0 * v, 1.5],
        }
    };
    (0..num_points).map(point).collect()
}

/// Allocations and bytes of each of twelve frames of about so many points, with a few that are not finite. The first three
/// frames are a tenth larger than the others: a cloud larger than all before needs more memory.
fn allocations_of_frames(num_points: usize, threads: usize, options: Options) -> Vec<[usize; 2]> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut detector = Detector::new(Model::builtin(Builtin::Compact), options).unwrap();
    let mut detection = Detection::default();
    let frame = |number: usize| {
        let num_points = if number < 3 { num_points + num_points / 10 } else { num_points };
        let mut points = street(num_points, 10.0 + number as f32);
        points[7 * number][1] = f32::NAN;
        points
    };
    let frames: Vec<Vec<Point>> = (0..12).map(frame).collect();
    let mut used = Vec::with_capacity(frames.len());
    pool.install(|| {
        for points in &frames {
            let start = [NUMBER.load(Relaxed), BYTES.load(Relaxed)];
            detector.detect_into(points, &mut detection).unwrap();
            used.push([NUMBER.load(Relaxed) - start[0], BYTES.load(Relaxed) - start[1]]);
        }
    });
    assert!(detection.keypoints.len() > 5 && detection.num_skipped == 1);
    let is_many = options.detect.max_keypoints > 256;
    assert!(!is_many || detection.keypoints.len() >= 256, "{} keypoints", detection.keypoints.len());
    used
}

/// Options with `max_points`, with radii in resolutions, and with many keypoints.
fn variants(recommended: Options) -> [(&'static str, Options); 4] {
    let [mut sampled, mut in_resolutions, mut many] = [recommended; 3];
    sampled.encode.max_points = Some(5000);
    in_resolutions.detect.nms_radius = Some(Length::Resolutions(4.0));
    in_resolutions.detect.mode_radius = Some(Length::Resolutions(3.0));
    many.detect.nms_radius = None;
    many.detect.mode_radius = None;
    many.detect.saliency_threshold = 0.0;
    many.detect.max_keypoints = 700;
    let mut all = many;
    all.encode.max_points = sampled.encode.max_points;
    all.detect.nms_radius = Some(Length::Resolutions(0.5));
    [("max_points", sampled), ("radii in resolutions", in_resolutions), ("many keypoints", many), ("all", all)]
}

/// One test: the counts are those of the whole program.
#[test]
fn frames_use_the_memory_of_earlier_frames() {
    // A frame of the first release made 22 000 allocations of 274 MB.
    let options = *Model::builtin(Builtin::Compact).recommended();
    for num_points in [8000, 64_000] {
        let used = allocations_of_frames(num_points, 1, options);
        println!("[allocations, bytes] of each frame of {num_points} points on one thread: {used:?}");
        assert_eq!(used[3..], [[0; 2]; 9]);
    }
    for (name, options) in variants(options) {
        let used = allocations_of_frames(20_000, 1, options);
        println!("[allocations, bytes] of each frame of 20 000 points with {name}: {used:?}");
        // The draw of a sample is that of the crate `rand`, which takes memory of its own.
        let most = if options.encode.max_points.is_some() { 2 } else { 0 };
        assert!(used[3..].iter().all(|used| used[0] <= most), "{name}");
    }
    // With more threads, chance decides which of them does a part of the work for the first time and needs memory for it.
    let used = allocations_of_frames(8000, 2, options);
    println!("[allocations, bytes] of each frame of 8000 points on two threads: {used:?}");
    assert!(used[3..].iter().all(|used| used[0] <= 40) && used[3..].contains(&[0; 2]), "{used:?}");

    let bytes = |num_points| allocations_of_frames(num_points, 1, options).iter().map(|used| used[1]).sum::<usize>();
    let bytes_per_point = (bytes(100_000) - bytes(30_000)) as f64 / (1.1 * 70_000.0);
    println!("{bytes_per_point:.1} bytes a point");
    assert!(bytes_per_point < 60.0);
}

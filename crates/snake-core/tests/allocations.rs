//! Memory that a detector allocates for each cloud. A test binary of its own, because its allocator counts for all threads.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use snake_core::{Builtin, Detection, FrameDetector, Model, Point};

/// The allocator of the system, with counts of bytes.
struct Counting;

static ALLOCATED: AtomicUsize = AtomicUsize::new(0);
static LARGEST: AtomicUsize = AtomicUsize::new(0);
static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

// SAFETY: both functions hand their arguments to the allocator of the system.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let size = layout.size();
        ALLOCATED.fetch_add(size, Relaxed);
        LARGEST.fetch_max(size, Relaxed);
        PEAK.fetch_max(LIVE.fetch_add(size, Relaxed) + size, Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The bytes of a frame.
struct Usage {
    /// The largest allocation.
    largest: usize,
    /// The most at a time, beyond those before the first frame.
    peak: usize,
    /// Those that stay after the frame, beyond those before the first frame.
    kept: usize,
}

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

/// The usage of each of twelve frames of about so many points, with one that is not finite. The first three frames are a
/// tenth larger than the others: a cloud larger than all before needs more memory.
fn usage_of_frames(num_points: usize, threads: usize) -> Vec<Usage> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let model = Model::builtin(Builtin::Compact);
    let mut detector = FrameDetector::new(model.clone(), *model.recommended()).unwrap();
    let mut detection = Detection::default();
    let frame = |number: usize| {
        let num_points = if number < 3 { num_points + num_points / 10 } else { num_points };
        let mut points = street(num_points, 10.0 + number as f32);
        points[7 * number][1] = f32::NAN;
        points
    };
    let frames: Vec<Vec<Point>> = (0..12).map(frame).collect();
    let before = LIVE.load(Relaxed);
    let mut detect = |points: &Vec<Point>| {
        [&ALLOCATED, &LARGEST, &PEAK].into_iter().for_each(|count| count.store(0, Relaxed));
        detector.detect_into(points, &mut detection).unwrap();
        let [allocated, largest, peak, live] = [&ALLOCATED, &LARGEST, &PEAK, &LIVE].map(|count| count.load(Relaxed));
        let (peak, kept) = (peak - before, live - before);
        println!("{num_points} points, {threads} threads: {allocated} bytes, {largest} at once, peak {peak}");
        Usage { largest, peak, kept }
    };
    let usage = pool.install(|| frames.iter().map(&mut detect).collect());
    assert!(detection.keypoints.len() > 5 && detection.num_skipped == 1);
    usage
}

/// One test: the counts are those of the whole program.
#[test]
fn frames_use_the_volumes_of_earlier_frames() {
    let model = Model::builtin(Builtin::Compact);
    let field = model.encode(&street(8000, 10.0), &model.recommended().encode).unwrap();
    let volume = size_of_val(field.volume().features());
    for (num_points, threads) in [(8000, 1), (64_000, 1), (8000, 2)] {
        let usage = usage_of_frames(num_points, threads);
        // The first frame takes the volumes from the system, so the count sees them.
        assert!(usage[0].largest >= volume);
        assert!(usage[3..].iter().all(|frame| frame.largest < volume / 4));
        assert!(usage[3..].iter().all(|frame| frame.kept < usage[2].kept + volume / 16));
    }
    let [few, many] = [30_000, 100_000].map(|num_points| usage_of_frames(num_points, 1)[3].peak);
    let bytes_per_point = many.saturating_sub(few) as f64 / 70_000.0;
    println!("{bytes_per_point:.1} bytes a point");
    assert!((10.0..60.0).contains(&bytes_per_point));
}

//! Memory that a detector allocates for each cloud. A test binary of its own, because its allocator counts for all threads.

#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use snake_core::{Builtin, Detection, Detector, Model, Point};

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

/// A street of 8000 `density` points: the road, two walls, and a box at `ahead`.
fn street(density: usize, ahead: f32) -> Vec<Point> {
    let point = |i: usize| {
        let (u, v) = ((i as f32 * 0.754_877_7).fract(), (i as f32 * 0.569_840_3).fract());
        match i % 4 {
            0 => [40.0 * u, 12.0 * v, 0.0],
            1 => [40.0 * u, 0.0, 6.0 * v],
            2 => [40.0 * u, 12.0, 6.0 * v],
            _ => [ahead + 4.0 * u, 5.0 + 2.0 * v, 1.5],
        }
    };
    (0..8000 * density).map(point).collect()
}

/// Allocations and bytes of the fourth and fifth of five frames with so many points, and their number of keypoints.
fn of_later_frames(density: usize) -> ([usize; 2], usize) {
    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let mut detector = Detector::new(model, options).unwrap();
    let mut detection = Detection::default();
    let frames: Vec<Vec<Point>> = (0..5).map(|frame| street(density, 10.0 + frame as f32)).collect();
    let mut start = [0; 2];
    for (number, points) in frames.iter().enumerate() {
        if number == 3 {
            start = [NUMBER.load(Relaxed), BYTES.load(Relaxed)];
        }
        detector.detect_into(points, &mut detection).unwrap();
    }
    let end = [NUMBER.load(Relaxed), BYTES.load(Relaxed)];
    ([0, 1].map(|i| (end[i] - start[i]) / 2), detection.keypoints.len())
}

#[test]
fn allocations_of_a_frame_do_not_grow_with_its_points() {
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let (few, _) = one_thread.install(|| of_later_frames(1));
    let (many, keypoints) = one_thread.install(|| of_later_frames(8));
    println!("[allocations, bytes] of a frame of 8000 points: {few:?}, of 64 000 points: {many:?}");
    assert!(keypoints > 5);
    // A frame of the first release made 22 000 allocations of 274 MB. What is left belongs to the layers of the U-Net (their
    // tasks, constant voxels and sums of channels), to the planes of the query grid and to the k-d trees of suppression.
    assert!(many[0] < few[0] + 100 && many[0] < 400, "{few:?} {many:?}");
    // The groups of voxels take eight bytes a point. More points also reach more voxels.
    assert!(many[1] < few[1] + 30 * 56_000, "{few:?} {many:?}");
}

//! A detector that keeps up with a laser scanner: `cargo run --release -p snake-core --example realtime_loop`.
//!
//! Arguments: number of frames (200), points of a sweep (120000), target in milliseconds (100), threads (2), model (scenes).

mod sweep;

use std::error::Error;
use std::time::{Duration, Instant};

use snake_core::{Detection, FrameDetector, Model};

/// The value below which a share of the sorted values lies.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// Processor time of this process so far, in milliseconds, where the system tells it (Linux).
fn processor_milliseconds() -> Option<f64> {
    let schedule = std::fs::read_dir("/proc/self/task").ok()?;
    let run_seconds = |entry: std::fs::DirEntry| -> Option<f64> {
        let text = std::fs::read_to_string(entry.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse().ok()
    };
    Some(schedule.flatten().filter_map(run_seconds).sum::<f64>() / 1e6)
}

fn main() -> Result<(), Box<dyn Error>> {
    let argument = |place: usize, default: usize| std::env::args().nth(place).map_or(Ok(default), |text| text.parse());
    let (num_frames, num_points) = (argument(1, 200)?.max(1), argument(2, 120_000)?);
    let (target, threads) = (Duration::from_millis(argument(3, 100)? as u64), argument(4, 2)?);

    // The budget is measured in the pool that will detect. Keep the options as JSON to repeat a run elsewhere.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let model = Model::named(std::env::args().nth(5).as_deref().unwrap_or("scenes"))?;
    let options = pool.install(|| model.realtime_options(target, num_points))?;
    let mut detector = FrameDetector::new(model, options)?;
    let mut detection = Detection::default();
    println!("points: {:?}, voxel size: {:?}", options.encode.max_points, options.encode.voxel_size);

    let sweeps: Vec<_> = (0..20).map(|number| sweep::sweep(num_points, 0.5 * number as f32)).collect();
    let (mut wall, mut processor) = (Vec::new(), Vec::new());
    for number in 0..num_frames {
        let (start, spent) = (Instant::now(), processor_milliseconds());
        pool.install(|| detector.detect_into(&sweeps[number % sweeps.len()], &mut detection))?;
        wall.push(start.elapsed().as_secs_f64() * 1e3);
        processor.extend(processor_milliseconds().zip(spent).map(|(end, start)| end - start));
    }
    println!("{} keypoints in the last sweep", detection.keypoints.len());
    for (name, mut times) in [("wall time", wall), ("processor time", processor)] {
        times.sort_by(f64::total_cmp);
        if !times.is_empty() {
            println!("{name}: p50 {:.1} ms, p99 {:.1} ms", percentile(&times, 0.5), percentile(&times, 0.99));
        }
    }
    Ok(())
}

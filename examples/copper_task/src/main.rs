//! A task of Copper: clouds in, keypoints out, run in Copper's simulator.
//!
//! On a robot the driver of a sensor stands in `copperconfig.ron` in the place of `tasks::Lidar`, and `copper_runtime` has no
//! `sim_mode`.

mod tasks;

use cu29::prelude::*;

#[copper_runtime(config = "copperconfig.ron", sim_mode = true)]
struct Robot {}

fn main() -> CuResult<()> {
    simulate(5).map(|_| ())
}

/// The number of keypoints in each of these iterations, which are 0.1 s apart on the simulator's clock.
fn simulate(num_iterations: usize) -> CuResult<Vec<usize>> {
    let mut num_keypoints = Vec::new();
    // The simulator may answer every step itself. This one only looks at what reaches the sink.
    let mut observe = |step: default::SimStep<'_>| {
        if let default::SimStep::Printer(CuTaskCallbackState::Process(input, _)) = step {
            num_keypoints.extend(input.payload().map(|keypoints| keypoints.positions.len()));
        }
        SimOverride::ExecuteByRuntime
    };
    let (clock, time) = RobotClock::mock();
    let robot = Robot::builder().with_clock(clock).with_sim_callback(&mut observe).build()?;
    let mut running = robot.start(&mut observe)?;
    for _ in 0..num_iterations {
        time.increment(CuDuration::from_millis(100));
        running.run_one_iteration(&mut observe)?;
    }
    running.stop(&mut observe)?;
    Ok(num_keypoints)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cloud_gives_keypoints() {
        let num_keypoints = simulate(3).unwrap();
        assert_eq!(num_keypoints.len(), 3);
        assert!(num_keypoints.iter().all(|&number| number > 0), "{num_keypoints:?}");
    }
}

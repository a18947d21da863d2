//! The rigid transform between two clouds:
//! `cargo run --release --example register -- scan2.ply scan1.ply`.

use std::path::Path;

use snake_registration::{RegisterOptions, register};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1);
    let (Some(source), Some(target)) = (arguments.next(), arguments.next()) else {
        return Err("usage: register SOURCE TARGET".into());
    };
    let source = snake_io::read_points(Path::new(&source))?;
    let target = snake_io::read_points(Path::new(&target))?;

    let registration = register(&source, &target, &RegisterOptions::default())?;
    // A point of the source in the target's frame: p_target = R p_source + t.
    println!("{:?}", registration.t_target_source);
    println!("{}: confidence {:.2}", registration.verdict.word(), registration.verdict.confidence);
    println!("{:.1} % of the source lies on the target", 100.0 * registration.fit.fitness);
    Ok(())
}

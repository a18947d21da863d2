//! Writes a made city as LAS: `city FILE.las LOTS POINTS_PER_LOT`, for example 25 by 25 lots of 80 000 points, which are 50
//! million points on a quarter of a square kilometre. `FILE.copc.laz` is a COPC file, of at most 6 by 6 lots.

#[path = "../tests/city/mod.rs"]
mod city;

use std::fs::File;
use std::io::BufWriter;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, lots, points] = &arguments[..] else { return Err("usage: city FILE.las LOTS POINTS_PER_LOT".into()) };
    let mut file = BufWriter::new(File::create(path)?);
    let points = city::city(lots.parse()?, points.parse()?);
    if path.ends_with(".copc.laz") {
        Ok(city::copc::write_copc(&mut file, points, 1000)?)
    } else {
        Ok(city::write_las(&mut file, points)?)
    }
}

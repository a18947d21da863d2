//! Keypoints of clouds that do not fit into memory.
//!
//! ```text
//! files ─ 1. prepare ─→ points of each tile ─ 2. detect ─→ candidates of each tile ─ 3. finish ─→ keypoints
//! ```
//!
//! 1. [`TiledRun::prepare`] reads the files point by point and writes the points to a folder, one file per tile.
//! 2. [`TiledRun::detect`] encodes the voxels of one tile and writes their candidates. It reads the points of the tile and of a
//!    margin around it.
//! 3. [`TiledRun::finish`] suppresses the candidates, again tile by tile with the candidates of the
//!    neighbours that it needs, and finds the nearest point of each keypoint.
//!
//! The keypoints are bit-identical to those of [`snake_core::Model::detect`] on the whole cloud, for any size of the tiles.
//! Memory grows with the largest tile and the number of keypoints. A step whose result is in the folder is not repeated, so
//! an interrupted run continues where it stopped. A folder with another run, or with files that no run wrote, is refused.
//!
//! ```
//! use snake_core::{Builtin, Control, Model, TileDetector};
//! use snake_tiles::TiledRun;
//! # let folder = tempfile::tempdir()?;
//! # let scan = folder.path().join("scan.xyz");
//! # let line = |i: u32| format!("{} {} {}\n", 0.05 * f64::from(i % 30), 0.05 * f64::from(i / 30), 0.01 * f64::from(i % 7));
//! # std::fs::write(&scan, (0..900).map(line).collect::<String>())?;
//! let model = Model::builtin(Builtin::Scenes);
//! let detector = TileDetector::new(&model, model.recommended())?;
//! let run = TiledRun::prepare(detector, &[scan], &Default::default(), 50.0, &folder.path().join("tiles"))?;
//! for tile in run.tiles() {
//!     run.detect(tile, &Control::default())?;
//! }
//! println!("{} keypoints", run.finish(&Control::default())?.keypoints.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod by_bounds;
mod candidates;
mod error;
mod folder;
mod keypoints;
mod nearest;
mod plan;
mod points;
mod run;

pub use error::{Error, Result};
pub use keypoints::{Detected, TiledDetection, TiledKeypoint};
pub use plan::{Failure, Tile};
pub use run::TiledRun;

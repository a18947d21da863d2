//! `snake-cli`: keypoints from point-cloud files.
#![forbid(unsafe_code)]

use std::ffi::OsString;
use std::process::ExitCode;

fn main() -> ExitCode {
    let words: Vec<OsString> = std::env::args_os().collect();
    ExitCode::from(snake_keypoints::run(&words))
}

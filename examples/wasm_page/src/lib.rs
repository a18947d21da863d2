//! Detection in a browser: the bytes of a file go in, and the page that shows its cloud with the keypoints comes out.
//!
//! JavaScript calls [`input`], writes the name of the file and its bytes there, calls [`detect`], and reads the page, or the
//! reason why there is none, at [`output`].

use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use snake_core::{Builtin, Control, Model};
use snake_io::{PointFormat, ReadOptions, parse_cloud};
use snake_view::{Page, ShownCloud, viridis};

static INPUT: Mutex<Vec<u8>> = Mutex::new(Vec::new());
static OUTPUT: Mutex<String> = Mutex::new(String::new());

/// Makes room for so many bytes and returns their place.
#[unsafe(no_mangle)]
pub extern "C" fn input(length: usize) -> *mut u8 {
    let mut input = lock(&INPUT);
    input.clear();
    input.resize(length, 0);
    input.as_mut_ptr()
}

/// Detects the keypoints of the cloud in the input, whose first `name_length` bytes are the name of the file. Returns whether
/// the output is a page; otherwise it is an error.
#[unsafe(no_mangle)]
pub extern "C" fn detect(name_length: usize) -> bool {
    let input = std::mem::take(&mut *lock(&INPUT));
    let (name, bytes) = input.split_at(name_length.min(input.len()));
    let page = page(&String::from_utf8_lossy(name), bytes);
    let is_page = page.is_ok();
    *lock(&OUTPUT) = page.unwrap_or_else(|error| error.to_string());
    is_page
}

/// The place of the output.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    lock(&OUTPUT).as_ptr()
}

/// The length of the output in bytes.
#[unsafe(no_mangle)]
pub extern "C" fn output_length() -> usize {
    lock(&OUTPUT).len()
}

fn page(name: &str, bytes: &[u8]) -> Result<String, Box<dyn std::error::Error>> {
    let format = match PointFormat::from_path(Path::new(name)) {
        // A browser does not tell the folder, by which sweeps of KITTI are known.
        Err(_) if name.ends_with(".bin") => PointFormat::Kitti,
        format => format?,
    };
    let cloud = parse_cloud(bytes, format, &ReadOptions::default())?;
    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let cloud = cloud.for_normalization(options.encode.normalization);
    let shown = ShownCloud::detect(&model, &options, name.into(), &cloud, &Control::default())?;
    let page = Page { clouds: vec![shown], pair: None, options, model_name: "compact".into(), colors: viridis() };
    Ok(page.html()?)
}

fn lock<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

//! C arguments as slices and texts, with all checks that are possible.

use std::borrow::Cow;
use std::ffi::{CStr, c_char};

use serde_json::{Map, Value};
use snake_core::Point;

use crate::status::{Failure, Result, SnakeStatus};

fn refused(what: &str, reason: &str) -> Failure {
    Failure::new(SnakeStatus::Argument, format!("{what}: {reason}"))
}

/// Refuses a pointer to which no result can be written.
pub(crate) fn check_output<T>(what: &str, pointer: *mut T) -> Result<()> {
    aligned(what, pointer)
}

/// The value behind a pointer.
///
/// # Safety
/// `pointer` is null or valid.
pub(crate) unsafe fn input<'a, T>(what: &str, pointer: *const T) -> Result<&'a T> {
    aligned(what, pointer)?;
    // SAFETY: the pointer is neither null nor misaligned; the caller vouches for the rest.
    Ok(unsafe { &*pointer })
}

/// The value behind a pointer; `None` for null.
///
/// # Safety
/// As for [`input`].
pub(crate) unsafe fn optional<'a, T>(what: &str, pointer: *const T) -> Result<Option<&'a T>> {
    // SAFETY: the caller vouches for the pointer.
    (!pointer.is_null()).then(|| unsafe { input(what, pointer) }).transpose()
}

fn aligned<T>(what: &str, pointer: *const T) -> Result<()> {
    match pointer {
        _ if pointer.is_null() => Err(refused(what, "null")),
        _ if !pointer.is_aligned() => Err(refused(what, "misaligned")),
        _ => Ok(()),
    }
}

/// `length` values that begin at a pointer.
///
/// # Safety
/// `pointer` is null or valid for reads of `length` values.
pub(crate) unsafe fn values<'a, T>(what: &str, pointer: *const T, length: usize) -> Result<&'a [T]> {
    if length == 0 {
        return Ok(&[]);
    }
    aligned(what, pointer)?;
    if length > isize::MAX as usize / size_of::<T>() {
        return Err(refused(what, "longer than the address space"));
    }
    // SAFETY: the pointer is neither null nor misaligned, and the length is possible; the caller vouches for the rest.
    Ok(unsafe { std::slice::from_raw_parts(pointer, length) })
}

/// A cloud of the caller, which is read where it is.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct SnakeCloud {
    /// x, y and z of the first point.
    pub points: *const f32,
    /// Number of points.
    pub num_points: usize,
    /// Number of floats from one point to the next: 3 for packed points, 4 for `pcl::PointXYZ`.
    pub stride: usize,
}

impl SnakeCloud {
    /// The points, without a copy if they are packed.
    ///
    /// # Safety
    /// `points` is null or valid for reads of `(num_points - 1) * stride + 3` values.
    pub(crate) unsafe fn read<'a>(self, what: &str) -> Result<Cow<'a, [Point]>> {
        if self.stride < 3 {
            return Err(refused(what, "the stride is below 3 floats"));
        }
        let others = self.num_points.saturating_sub(1);
        let length = others.checked_mul(self.stride).and_then(|length| length.checked_add(3));
        let length = length.ok_or_else(|| refused(what, "longer than the address space"))?;
        // SAFETY: the caller vouches for these values.
        let values = unsafe { values(what, self.points, if self.num_points == 0 { 0 } else { length }) }?;
        Ok(match self.stride {
            3 => Cow::Borrowed(values.as_chunks().0),
            stride => values.chunks(stride).map(|point| [point[0], point[1], point[2]]).collect(),
        })
    }
}

/// A text in UTF-8.
///
/// # Safety
/// `pointer` is null or a text that ends with a zero.
pub(crate) unsafe fn text<'a>(what: &str, pointer: *const c_char) -> Result<&'a str> {
    aligned(what, pointer)?;
    // SAFETY: the pointer is not null; the caller vouches for the zero.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| refused(what, "not UTF-8"))
}

/// Options as a JSON object; no options for null.
///
/// # Safety
/// As for [`text`].
pub(crate) unsafe fn options(pointer: *const c_char) -> Result<Map<String, Value>> {
    if pointer.is_null() {
        return Ok(Map::new());
    }
    // SAFETY: the caller vouches for the text.
    let text = unsafe { text("options", pointer) }?;
    let refused = |reason| Failure::new(SnakeStatus::Option, format!("options: not a JSON object: {reason}"));
    serde_json::from_str(text).map_err(refused)
}

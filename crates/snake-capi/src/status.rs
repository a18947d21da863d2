//! Errors as codes, with a text per thread.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use snake_core::{Error, printable, shortened};

/// The result of a function. `snake_last_error` has the reason as text.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SnakeStatus {
    /// The result is complete.
    Ok = 0,
    /// A pointer is null or misaligned, a text is not UTF-8, or a length is impossible.
    Argument = 1,
    /// A cloud that cannot be used, without finite points or without extent; or clouds that no transform fits.
    Input = 2,
    /// Options that cannot be used: no JSON object, an unknown name, or a value of another type or out of its range.
    Option = 3,
    /// A weight file does not hold the network that it names.
    Weights = 4,
    /// A file cannot be read.
    Io = 5,
    /// An error within the library, which is a defect of it.
    Internal = 6,
}

/// The reason why a call failed.
pub(crate) struct Failure {
    status: SnakeStatus,
    text: String,
}

impl Failure {
    pub(crate) fn new(status: SnakeStatus, text: impl Into<String>) -> Self {
        Self { status, text: text.into() }
    }

    fn from_panic(panic: &(dyn Any + Send)) -> Self {
        let reason = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
        Self::new(SnakeStatus::Internal, format!("panic: {}", reason.unwrap_or("without a text")))
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match error {
            Error::Input { what: "options", .. } | Error::Option { .. } => SnakeStatus::Option,
            Error::Input { .. } | Error::NoTransform { .. } => SnakeStatus::Input,
            Error::Weights { .. } => SnakeStatus::Weights,
            Error::Io { .. } => SnakeStatus::Io,
            _ => SnakeStatus::Internal,
        };
        Self::new(status, error.to_string())
    }
}

pub(crate) type Result<T> = std::result::Result<T, Failure>;

thread_local! {
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Runs the body of a function. Stores the text of an error. Turns a panic into an error: it must not reach C.
pub(crate) fn guarded(body: impl FnOnce() -> Result<()>) -> SnakeStatus {
    let failure = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return SnakeStatus::Ok,
        Ok(Err(failure)) => failure,
        Err(panic) => Failure::from_panic(&*panic),
    };
    // The text has bounded length, no zeros, which would end it, and no characters that control a terminal.
    let text = CString::new(printable(&shortened(&failure.text)).as_bytes()).unwrap_or_default();
    // A thread that is ending has no text; the status remains.
    let _ = LAST_ERROR.try_with(|last| last.replace(text));
    failure.status
}

/// The reason of the last error of this thread, or an empty text. It is UTF-8 and valid until the next function of this
/// library that this thread calls.
#[unsafe(no_mangle)]
pub extern "C" fn snake_last_error() -> *const c_char {
    LAST_ERROR.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_with_its_text() {
        let beyond = |numbers: &[u8]| numbers[numbers.len()].to_string();
        let status = guarded(|| crate::threads::run(|| Err(Failure::new(SnakeStatus::Io, beyond(&[1, 2])))));
        assert_eq!(status, SnakeStatus::Internal);
        // SAFETY: the text is that of this thread.
        let text = unsafe { std::ffi::CStr::from_ptr(snake_last_error()) };
        assert!(text.to_str().unwrap().starts_with("panic: index out of bounds"), "{text:?}");
    }

    #[test]
    fn texts_have_no_control_characters() {
        guarded(|| Err(Failure::new(SnakeStatus::Io, "a\u{1b}[2Jb\0c\nd\u{202e}: no such file")));
        // SAFETY: the text is that of this thread.
        let text = unsafe { std::ffi::CStr::from_ptr(snake_last_error()) };
        assert_eq!(text.to_str().unwrap(), "a\\u{1b}[2Jb\\0c\\nd\\u{202e}: no such file");
    }
}

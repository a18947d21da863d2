//! Models.

use std::ffi::c_char;

use snake_core::{Chooser, Model, NamedModel};

use crate::arguments::{check_output, text, values};
use crate::status::{Result, SnakeStatus, guarded};
use crate::threads::run;

/// A network with its weights, or the choice between those that are built in. Several threads may use one at the same time.
pub struct SnakeModel {
    pub(crate) chooser: Chooser,
}

/// Stores a pointer to the loaded model in `place`, or a null pointer after an error.
///
/// # Safety
/// `place` is null or valid for a write.
unsafe fn store<T: Send>(
    place: *mut *mut SnakeModel,
    source: Result<T>,
    load: impl FnOnce(T) -> Result<Chooser> + Send,
) -> SnakeStatus {
    guarded(|| {
        check_output("model", place)?;
        // SAFETY: the place is neither null nor misaligned; the caller vouches for the rest.
        unsafe { place.write(std::ptr::null_mut()) };
        let model = Box::new(SnakeModel { chooser: run(|| load(source?))? });
        // SAFETY: as above.
        unsafe { place.write(Box::into_raw(model)) };
        Ok(())
    })
}

/// The built-in model that suits each cloud, chosen anew by every call, as `snake-cli` does without `--model`. Options that only
/// one kind of model has name it: `voxel_size` "scenes", and `preset`, `normalization` and several `rotations` "compact". Else it
/// is "scenes" for a cloud that looks like a room, a sweep or terrain, and "compact" for others. Each is loaded when it is
/// first used. `*model` is null after an error.
///
/// # Safety
/// `model` is null or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_model_auto(model: *mut *mut SnakeModel) -> SnakeStatus {
    // SAFETY: the caller vouches for the place.
    unsafe { store(model, Ok(()), |()| Ok(Chooser::default())) }
}

/// A built-in model: "compact" or "standard" for objects, "scenes" for rooms, sweeps and terrain. `*model` is null after an error.
///
/// # Safety
/// `name` is null or a text that ends with a zero; `model` is null or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_model_named(name: *const c_char, model: *mut *mut SnakeModel) -> SnakeStatus {
    // SAFETY: the caller vouches for both.
    unsafe {
        store(model, text("name", name), |name| {
            Ok(NamedModel::new(Model::named(name)?, format!("{name}, built-in")).into())
        })
    }
}

/// Reads a weight file (safetensors). `*model` is null after an error.
///
/// # Safety
/// `path` is null or a text in UTF-8 that ends with a zero; `model` is null or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_model_load(path: *const c_char, model: *mut *mut SnakeModel) -> SnakeStatus {
    // SAFETY: the caller vouches for both.
    unsafe { store(model, text("path", path), |path| Ok(NamedModel::new(Model::load(path)?, path).into())) }
}

/// A model from the bytes of a weight file. `*model` is null after an error.
///
/// # Safety
/// `bytes` is null or valid for `length` bytes; `model` is null or valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_model_from_bytes(
    bytes: *const u8,
    length: usize,
    model: *mut *mut SnakeModel,
) -> SnakeStatus {
    // SAFETY: the caller vouches for both.
    unsafe {
        store(model, values("bytes", bytes, length), |bytes| {
            Ok(NamedModel::new(Model::from_bytes(bytes)?, "without a name").into())
        })
    }
}

/// Frees a model; null is allowed.
///
/// # Safety
/// `model` is null or a model of this library that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn snake_model_free(model: *mut SnakeModel) {
    // SAFETY: the caller vouches for the model.
    unsafe { free(model) }
}

/// Frees a pointer from [`Box::into_raw`]; null is allowed.
///
/// # Safety
/// `pointer` is null or from [`Box::into_raw`], and not freed yet.
pub(crate) unsafe fn free<T>(pointer: *mut T) {
    guarded(|| {
        if !pointer.is_null() {
            // SAFETY: the caller vouches for the pointer.
            drop(unsafe { Box::from_raw(pointer) });
        }
        Ok(())
    });
}

/// The version of the library, such as "0.1.0".
#[unsafe(no_mangle)]
pub extern "C" fn snake_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

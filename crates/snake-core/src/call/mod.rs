//! What a call may do: progress and cancellation, limits, threads.

pub(crate) mod clock;
pub(crate) mod control;
pub(crate) mod limits;
pub(crate) mod progress;
mod side_by_side;
pub(crate) mod span;
mod threads;

pub use control::{CancelFlag, Control, Counter};
pub use limits::Limits;
pub use progress::{Progress, Stage};
pub use side_by_side::side_by_side;
pub use threads::check_num_threads;

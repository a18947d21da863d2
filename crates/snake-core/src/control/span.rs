//! Spans of the steps of a call, for the feature `tracing`.

/// Enters a span of this name until the end of the block. Without the feature `tracing` it does nothing.
macro_rules! span {
    ($name:literal) => {
        #[cfg(feature = "tracing")]
        let _span = tracing::info_span!($name).entered();
    };
}
pub(crate) use span;

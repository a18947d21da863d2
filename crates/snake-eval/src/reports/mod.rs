//! Reports: the figures of many pairs, summarised as tables, curves, CSV and JSON.

pub mod registration;
pub mod repeatability;
pub mod semantic;

use serde::{Deserialize, Serialize};

/// The figures of one pair of clouds, or of one shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pair<Row> {
    /// The name of the pair or shape.
    pub name: String,
    /// The rows, in the same order for every pair.
    pub rows: Vec<Row>,
}

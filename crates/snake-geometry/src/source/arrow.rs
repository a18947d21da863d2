//! Clouds as Apache Arrow arrays.

use arrow_array::cast::AsArray;
use arrow_array::types::Float32Type;
use arrow_array::{Array, FixedSizeListArray, PrimitiveArray};

use crate::{Error, Point, PointSource, Result};

/// A cloud as an Arrow array of type `FixedSizeList<f32, 3>`, without a copy. A null point, and a point with a null
/// coordinate, is not finite.
#[derive(Debug, Clone, Copy)]
pub struct ArrowPoints<'a> {
    list: &'a FixedSizeListArray,
    values: &'a PrimitiveArray<Float32Type>,
}

impl<'a> ArrowPoints<'a> {
    /// The cloud of an array.
    ///
    /// # Errors
    /// [`Error::Input`] when the array is of another type. The text names the type.
    pub fn new(array: &'a dyn Array) -> Result<Self> {
        let list = array.as_fixed_size_list_opt().filter(|list| list.value_length() == 3);
        let values = list.and_then(|list| Some((list, list.values().as_primitive_opt::<Float32Type>()?)));
        match values {
            Some((list, values)) => Ok(Self { list, values }),
            None => {
                let reason = format!("an Arrow array of type {}, not FixedSizeList<Float32, 3>", array.data_type());
                Err(Error::Input { what: "points", reason })
            }
        }
    }
}

impl PointSource for ArrowPoints<'_> {
    fn num_points(&self) -> usize {
        self.list.len()
    }

    fn point(&self, index: usize) -> Point {
        if self.list.is_null(index) {
            return [f32::NAN; 3];
        }
        let start = self.list.value_offset_at(index);
        std::array::from_fn(
            |axis| if self.values.is_null(start + axis) { f32::NAN } else { self.values.value(start + axis) },
        )
    }
}

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

#[cfg(test)]
mod tests {
    use arrow_array::{ArrayRef, Float64Array};

    use super::*;

    #[test]
    fn nulls_are_not_finite_and_slices_keep_their_place() {
        let points = [Some(vec![Some(1.0), Some(2.0), Some(3.0)]), None, Some(vec![Some(4.0), None, Some(6.0)])];
        let array = FixedSizeListArray::from_iter_primitive::<Float32Type, _, _>(points, 3);
        let points = ArrowPoints::new(&array).unwrap().to_points();
        assert_eq!((points.len(), points[0], points[1][0].is_nan()), (3, [1.0, 2.0, 3.0], true));
        assert!(points[2][0] == 4.0 && points[2][1].is_nan());
        let slice = array.slice(2, 1);
        assert_eq!(ArrowPoints::new(&slice).unwrap().point(0)[2], 6.0);
    }

    #[test]
    fn other_types_are_refused_by_name() {
        let pairs = FixedSizeListArray::from_iter_primitive::<Float32Type, _, _>([Some([Some(1.0); 2])], 2);
        let doubles: ArrayRef = std::sync::Arc::new(Float64Array::from(vec![1.0]));
        for (array, name) in [(&pairs as &dyn Array, "2"), (&*doubles, "Float64")] {
            let error = ArrowPoints::new(array).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("FixedSizeList<Float32, 3>"), "{error}");
        }
    }
}

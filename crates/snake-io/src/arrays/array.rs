//! Arrays of numbers with any shape, as in NumPy.

use crate::table::scalar::Scalar;

/// An array of numbers in C order: the last axis varies fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// The length of each axis.
    pub shape: Vec<usize>,
    /// The values, as many as the product of the lengths.
    pub items: Vec<f64>,
}

impl Array {
    /// Decodes an array from its bytes, its type in NumPy's notation (`<f8`), and its order. Bytes after the array are
    /// ignored.
    ///
    /// # Errors
    /// A reason, when the items are neither floats nor integers or the data is too short.
    pub fn decode(descr: &str, shape: &[usize], fortran_order: bool, data: &[u8]) -> std::result::Result<Self, String> {
        let scalar = Scalar::parse(descr)
            .ok_or_else(|| format!("items of type `{descr:.20}`; floats and integers can be read"))?;
        // This check comes before any allocation, because a file can claim any shape.
        let length = shape.iter().try_fold(1_usize, |product, &length| product.checked_mul(length));
        let bytes = length.and_then(|length| length.checked_mul(scalar.size));
        let Some(data) = bytes.and_then(|bytes| data.get(..bytes)) else {
            return Err(format!("shape {shape:?} of {} bytes each, but {} bytes follow", scalar.size, data.len()));
        };
        let items = data.chunks_exact(scalar.size).map(|item| scalar.decode(item)).collect();
        let array = Self { shape: shape.to_vec(), items };
        Ok(if fortran_order && shape.len() > 1 { array.with_first_axis_fastest() } else { array })
    }

    /// Converts items in Fortran order (first axis fastest) to C order.
    fn with_first_axis_fastest(self) -> Self {
        let strides: Vec<usize> = self
            .shape
            .iter()
            .scan(1, |stride, &length| {
                *stride *= length;
                Some(*stride / length.max(1))
            })
            .collect();
        let mut place = vec![0; self.shape.len()];
        let mut items = Vec::with_capacity(self.items.len());
        for _ in 0..self.items.len() {
            items.push(self.items[place.iter().zip(&strides).map(|(at, stride)| at * stride).sum::<usize>()]);
            for axis in (0..place.len()).rev() {
                place[axis] += 1;
                if place[axis] < self.shape[axis] {
                    break;
                }
                place[axis] = 0;
            }
        }
        Self { shape: self.shape, items }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_orders_of_any_shape() {
        let bytes: Vec<u8> = (0..24).collect();
        let c = Array::decode("|u1", &[2, 3, 4], false, &bytes).unwrap();
        assert_eq!((c.items[0], c.items[23], c.shape.len()), (0.0, 23.0, 3));
        // NumPy: arange(24).reshape(2, 3, 4, order="F").ravel()
        let fortran = Array::decode("|u1", &[2, 3, 4], true, &bytes).unwrap();
        let first = [0.0, 6.0, 12.0, 18.0, 2.0, 8.0, 14.0, 20.0, 4.0, 10.0, 16.0, 22.0, 1.0];
        assert_eq!((&fortran.items[..13], fortran.items[23]), (&first[..], 23.0));
        assert_eq!(Array::decode(">i2", &[], false, &[0xff, 0xfe]).unwrap().items, [-2.0]);
        assert!(Array::decode("<f8", &[0, 9], true, &[]).unwrap().items.is_empty());
    }

    #[test]
    fn what_is_too_short_or_no_number_is_refused() {
        for shape in [&[3, 3][..], &[usize::MAX, 2], &[1 << 62]] {
            assert!(Array::decode("<f8", shape, false, &[0; 71]).unwrap_err().contains("71 bytes follow"));
        }
        assert!(Array::decode("|O", &[1], false, &[0; 8]).unwrap_err().contains("`|O`"));
    }
}

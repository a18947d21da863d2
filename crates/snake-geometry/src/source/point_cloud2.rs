//! Clouds as bytes with named fields, in the layout of the ROS message `sensor_msgs/PointCloud2`.

use crate::{Cloud, Error, Point, PointSource, Result};

/// One field of a point, as in `sensor_msgs/PointField`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PointField<'a> {
    /// Its name. Only `x`, `y` and `z` are read.
    pub name: &'a str,
    /// Offset from the start of the point, in bytes.
    pub offset: usize,
    /// Type of its numbers: 1 to 8 are int8, uint8, int16, uint16, int32, uint32, float32 and float64.
    pub datatype: u8,
    /// Numbers in the field. 0 counts as 1, as old drivers write it.
    pub count: usize,
}

/// The arrangement of the points of a [`PointCloud2View`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PointCloud2Layout {
    /// Number of rows; 1 for a cloud without order.
    pub height: usize,
    /// Points in a row.
    pub width: usize,
    /// Bytes from one point to the next.
    pub point_step: usize,
    /// Bytes from one row to the next; more than `width * point_step` if rows are padded. Many drivers put another number
    /// here, such as 0 or the size of the whole cloud. If it does not fit and the data has exactly the size of the rows
    /// without padding, they follow each other.
    pub row_step: usize,
    /// Whether the most significant byte of a number comes first.
    pub is_bigendian: bool,
}

/// Magnitudes of coordinates that are not zero, in any unit.
const PLAUSIBLE: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

/// Maximum number of points whose byte order is checked.
const MAX_CHECKED: usize = 1000;

/// A cloud of strided bytes, without a copy. Coordinates are of any type. As a [`PointSource`] they are read as `f32`;
/// [`PointCloud2View::to_cloud`] keeps the digits of coordinates far from zero, such as UTM.
///
/// ```
/// use snake_geometry::{PointCloud2Layout, PointCloud2View, PointField, PointSource};
///
/// let data: Vec<u8> = [1.0_f32, 2.0, 3.0, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
/// let field = |name, offset| PointField { name, offset, datatype: 7, count: 1 };
/// let fields = [field("x", 0), field("y", 4), field("z", 8), field("intensity", 12)];
/// let layout = PointCloud2Layout { height: 1, width: 1, point_step: 16, row_step: 16, is_bigendian: false };
/// let cloud = PointCloud2View::new(layout, &fields, &data)?;
/// assert_eq!(cloud.to_points(), [[1.0, 2.0, 3.0]]);
/// # Ok::<(), snake_geometry::Error>(())
/// ```
#[derive(Debug, Clone, Copy)]
pub struct PointCloud2View<'a> {
    layout: PointCloud2Layout,
    /// Offset and type of x, y and z.
    axes: [(usize, u8); 3],
    data: &'a [u8],
}

impl<'a> PointCloud2View<'a> {
    /// The cloud of a message. Point `row * width + column` is that of its row and column.
    ///
    /// # Errors
    /// [`Error::Input`] when a field is missing, is given twice, has an unknown type or reaches beyond `point_step`, and
    /// when the rows overlap or reach beyond `data`. The text names the field. Also when only the other byte order than
    /// `is_bigendian` gives coordinates of plausible magnitudes.
    pub fn new(layout: PointCloud2Layout, fields: &[PointField], data: &'a [u8]) -> Result<Self> {
        let axis = |name| axis(name, fields, layout.point_step);
        let axes = [axis("x")?, axis("y")?, axis("z")?];
        let row_step = row_step(&layout, data.len())?;
        let view = Self { layout: PointCloud2Layout { row_step, ..layout }, axes, data };
        if view.has_swapped_bytes() {
            let reason = format!("{} contradicts the byte order of the coordinates", layout.is_bigendian);
            return Err(Error::Input { what: "is_bigendian", reason });
        }
        Ok(view)
    }

    /// Whether most of the coordinates are plausible only in the other byte order. With swapped
    /// bytes three of four numbers are not plausible; zeros are zeros in both orders.
    fn has_swapped_bytes(&self) -> bool {
        let is_bigendian = !self.layout.is_bigendian;
        let swapped = Self { layout: PointCloud2Layout { is_bigendian, ..self.layout }, ..*self };
        let num_points = self.num_points();
        let checked = (0..num_points).step_by(num_points.div_ceil(MAX_CHECKED).max(1));
        let pairs = checked.flat_map(|index| std::iter::zip(self.position(index), swapped.position(index)));
        let (mut num_stated, mut num_swapped, mut num_numbers) = (0_usize, 0_usize, 0_usize);
        for (stated, swapped) in pairs.filter(|(stated, _)| *stated != 0.0) {
            let [is_stated, is_swapped] = [stated, swapped].map(|value| PLAUSIBLE.contains(&value.abs()));
            num_stated += usize::from(is_stated && !is_swapped);
            num_swapped += usize::from(is_swapped && !is_stated);
            num_numbers += usize::from(!(stated.is_nan() || swapped.is_nan()));
        }
        2 * num_swapped > num_numbers && num_swapped > 20 * num_stated
    }

    /// All points `(N, 3)`, relative to an origin if they are far from zero.
    pub fn to_cloud(&self) -> Cloud {
        Cloud::from_positions((0..self.num_points()).map(|index| self.position(index)))
    }

    /// A point with full precision.
    fn position(&self, index: usize) -> [f64; 3] {
        let PointCloud2Layout { width, point_step, row_step, .. } = self.layout;
        let start = index / width * row_step + index % width * point_step;
        self.axes.map(|(offset, datatype)| self.coordinate(start + offset, datatype))
    }

    fn coordinate(&self, start: usize, datatype: u8) -> f64 {
        match datatype {
            1 => f64::from(i8::from_le_bytes(self.number(start))),
            2 => f64::from(u8::from_le_bytes(self.number(start))),
            3 => f64::from(i16::from_le_bytes(self.number(start))),
            4 => f64::from(u16::from_le_bytes(self.number(start))),
            5 => f64::from(i32::from_le_bytes(self.number(start))),
            6 => f64::from(u32::from_le_bytes(self.number(start))),
            7 => f64::from(f32::from_le_bytes(self.number(start))),
            _ => f64::from_le_bytes(self.number(start)),
        }
    }

    fn number<const SIZE: usize>(&self, start: usize) -> [u8; SIZE] {
        let mut bytes: [u8; SIZE] = std::array::from_fn(|i| self.data[start + i]);
        if self.layout.is_bigendian {
            bytes.reverse();
        }
        bytes
    }
}

impl PointSource for PointCloud2View<'_> {
    fn num_points(&self) -> usize {
        self.layout.height * self.layout.width
    }

    fn point(&self, index: usize) -> Point {
        self.position(index).map(|value| value as f32)
    }
}

/// The number of bytes from one row to the next, for data of this length.
fn row_step(layout: &PointCloud2Layout, length: usize) -> Result<usize> {
    let PointCloud2Layout { height, width, point_step, row_step, .. } = *layout;
    let refuse = |what, reason| Err(Error::Input { what, reason });
    let Some(row) = width.checked_mul(point_step) else {
        return refuse("width", format!("{width} points of {point_step} bytes"));
    };
    // The padding of the last row may be missing.
    let size = height.saturating_sub(1).checked_mul(row_step).and_then(|rows| rows.checked_add(row));
    match size {
        _ if height == 0 || width == 0 => Ok(0),
        Some(size) if size <= length && (height == 1 || row_step >= row) => Ok(row_step),
        _ if height.checked_mul(row) == Some(length) => Ok(row),
        _ if height > 1 && row_step < row => refuse(
            "row_step",
            format!("{row_step} bytes, but a row has {row}, and the data has {length}, not {height} rows"),
        ),
        _ => refuse("data", format!("{length} bytes, too few for {height} rows of {width} points")),
    }
}

/// The offset and the type of a coordinate.
fn axis(name: &'static str, fields: &[PointField], point_step: usize) -> Result<(usize, u8)> {
    let refuse = |reason| Err(Error::Input { what: name, reason });
    let mut named = fields.iter().filter(|field| field.name == name);
    let Some(field) = named.next() else {
        let names: Vec<&str> = fields.iter().map(|field| field.name).collect();
        return refuse(format!("the cloud has no such field; its fields are {}", names.join(", ")));
    };
    if named.next().is_some() {
        return refuse("the cloud has two such fields".into());
    }
    if field.count > 1 {
        return refuse(format!("a field of {} numbers, not 1", field.count));
    }
    let size = match field.datatype {
        1 | 2 => 1,
        3 | 4 => 2,
        5..=7 => 4,
        8 => 8,
        other => return refuse(format!("type {other} of the field; types are 1 (int8) to 8 (float64)")),
    };
    match field.offset.checked_add(size) {
        Some(end) if end <= point_step => Ok((field.offset, field.datatype)),
        _ => refuse(format!("offset {} of the field reaches beyond the point of {point_step} bytes", field.offset)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(name: &'static str, offset: usize, datatype: u8) -> PointField<'static> {
        PointField { name, offset, datatype, count: 1 }
    }

    /// Two rows of two points, with padding before, between and after.
    fn message(is_bigendian: bool, is_double: bool) -> (PointCloud2Layout, [PointField<'static>; 4], Vec<u8>) {
        let (size, datatype) = if is_double { (8, 8) } else { (4, 7) };
        let fields = [
            field("ring", 0, 4),
            field("z", 2, datatype),
            field("x", 2 + size, datatype),
            field("y", 2 + 2 * size, datatype),
        ];
        let point_step = 2 + 3 * size + 3;
        let layout = PointCloud2Layout { height: 2, width: 2, point_step, row_step: 2 * point_step + 5, is_bigendian };
        let mut data = Vec::new();
        for row in 0..2 {
            for column in 0..2 {
                data.extend([9, 9]);
                let base = f64::from(10 * row + column);
                for value in [base + 0.75, base + 0.25, base + 0.5] {
                    let mut bytes =
                        if is_double { value.to_le_bytes().to_vec() } else { (value as f32).to_le_bytes().to_vec() };
                    if is_bigendian {
                        bytes.reverse();
                    }
                    data.extend(bytes);
                }
                data.extend([9; 3]);
            }
            data.extend([9; 5]);
        }
        (layout, fields, data)
    }

    #[test]
    fn both_byte_orders_and_types_with_padding_are_read() {
        let expected = [0.0, 1.0, 10.0, 11.0].map(|base| [base + 0.25, base + 0.5, base + 0.75]);
        for (is_bigendian, is_double) in [(false, false), (true, false), (false, true), (true, true)] {
            let (layout, fields, mut data) = message(is_bigendian, is_double);
            data.truncate(data.len() - 5); // the padding of the last row
            let view = PointCloud2View::new(layout, &fields, &data).unwrap();
            assert_eq!(view.to_points(), expected, "{is_bigendian} {is_double}");
            assert!(PointCloud2View::new(layout, &fields, &data[..data.len() - 1]).is_err());
        }
    }

    #[test]
    fn a_byte_order_that_contradicts_the_coordinates_is_refused() {
        for (is_bigendian, is_double) in [(false, false), (true, false), (false, true), (true, true)] {
            let (layout, fields, data) = message(is_bigendian, is_double);
            let lie = PointCloud2Layout { is_bigendian: !is_bigendian, ..layout };
            let error = PointCloud2View::new(lie, &fields, &data).unwrap_err().to_string();
            assert!(error.contains("is_bigendian") && error.contains("byte order"), "{error}");
        }
        // Unusual coordinates do not count as swapped bytes: zeros, missing points, and astronomical lengths.
        let fields = [field("x", 0, 7), field("y", 4, 7), field("z", 8, 7)];
        let layout = PointCloud2Layout { height: 1, width: 40, point_step: 12, row_step: 480, is_bigendian: false };
        let values: [fn(f32) -> f32; 4] = [|_| 0.0, |_| f32::NAN, |i| 1e16 * i.sin(), |i| 1e-20 * i.cos()];
        for value in values {
            let data: Vec<u8> = (0_u8..120).flat_map(|i| value(f32::from(i)).to_le_bytes()).collect();
            assert!(PointCloud2View::new(layout, &fields, &data).is_ok(), "{}", value(1.0));
        }
    }

    #[test]
    fn wrong_layouts_are_refused_by_field() {
        let (layout, fields, data) = message(false, false);
        let error =
            |layout, fields: &[PointField]| PointCloud2View::new(layout, fields, &data).unwrap_err().to_string();
        assert_eq!(error(layout, &fields[..3]), "y: the cloud has no such field; its fields are ring, z, x");
        let mut changed = fields;
        changed[2].datatype = 9;
        assert_eq!(error(layout, &changed), "x: type 9 of the field; types are 1 (int8) to 8 (float64)");
        changed = fields;
        changed[1].offset = 14;
        assert_eq!(error(layout, &changed), "z: offset 14 of the field reaches beyond the point of 17 bytes");
        changed = fields;
        changed[1].count = 2;
        assert_eq!(error(layout, &changed), "z: a field of 2 numbers, not 1");
        assert_eq!(error(layout, &[fields, fields].concat()), "x: the cloud has two such fields");
        let narrow = PointCloud2Layout { row_step: 33, ..layout };
        let expected = "row_step: 33 bytes, but a row has 34, and the data has 78, not 2 rows";
        assert_eq!(error(narrow, &fields), expected);
        let long = PointCloud2Layout { height: 3, ..layout };
        assert_eq!(error(long, &fields), "data: 78 bytes, too few for 3 rows of 2 points");
        for (height, width) in [(usize::MAX, 2), (2, usize::MAX)] {
            error(PointCloud2Layout { height, width, ..layout }, &fields);
        }
    }

    #[test]
    fn rows_follow_each_other_where_row_step_does_not_fit_and_the_size_of_the_data_does() {
        let fields = [field("x", 0, 7), field("y", 4, 7), field("z", 8, 7)];
        let data: Vec<u8> = (0_u8..18).flat_map(|value| f32::from(value).to_le_bytes()).collect();
        let layout = PointCloud2Layout { height: 3, width: 2, point_step: 12, row_step: 24, is_bigendian: false };
        let points = |row_step, data: &[u8]| {
            PointCloud2View::new(PointCloud2Layout { row_step, ..layout }, &fields, data).map(|view| view.to_points())
        };
        let expected = points(24, &data).unwrap();
        assert_eq!(expected[5], [15.0, 16.0, 17.0]);
        for row_step in [0, 2, 12, 72, usize::MAX] {
            assert_eq!(points(row_step, &data).unwrap(), expected, "{row_step}");
            for wrong in [&data[..71], &[&data[..], &[0; 7]].concat()] {
                assert!(points(row_step, wrong).is_err(), "{row_step}, {} bytes", wrong.len());
            }
        }
        // With a single row, the step does not matter.
        let one = PointCloud2Layout { height: 1, width: 6, row_step: 0, ..layout };
        assert_eq!(PointCloud2View::new(one, &fields, &data).unwrap().to_points(), expected);
    }

    #[test]
    fn coordinates_of_every_type_are_read_with_all_their_digits() {
        let values =
            |bytes: &dyn Fn(i8) -> Vec<u8>| [100, 101, 102, 110, 111, 112].into_iter().flat_map(bytes).collect();
        let all: [(u8, usize, Vec<u8>); 7] = [
            (1, 1, values(&|v| v.to_le_bytes().into())),
            (2, 1, values(&|v| (v as u8).to_le_bytes().into())),
            (3, 2, values(&|v| i16::from(v).to_le_bytes().into())),
            (4, 2, values(&|v| (v as u16).to_le_bytes().into())),
            (5, 4, values(&|v| i32::from(v).to_le_bytes().into())),
            (6, 4, values(&|v| (v as u32).to_le_bytes().into())),
            (8, 8, values(&|v| (f64::from(v) + 5e6 + 0.125).to_le_bytes().into())),
        ];
        for (datatype, size, data) in all {
            let fields = [("x", 0), ("y", size), ("z", 2 * size)].map(|(name, offset)| field(name, offset, datatype));
            let layout =
                PointCloud2Layout { height: 1, width: 2, point_step: 3 * size, row_step: 0, is_bigendian: false };
            let Cloud { points, origin } = PointCloud2View::new(layout, &fields, &data).unwrap().to_cloud();
            let far = if datatype == 8 { 5e6 + 0.125 } else { 0.0 };
            let positions: Vec<_> = points.into_iter().map(|point| crate::add_origin(point, origin)).collect();
            assert_eq!(
                positions,
                [[100.0, 101.0, 102.0], [110.0, 111.0, 112.0]].map(|p| p.map(|v| v + far)),
                "{datatype}"
            );
        }
    }

    #[test]
    fn clouds_without_points_have_none() {
        let (layout, fields, _) = message(false, false);
        for (height, width) in [(0, 5), (5, 0), (0, 0)] {
            let layout = PointCloud2Layout { height, width, row_step: 17 * width, ..layout };
            let (data, view) = (Vec::new(), |data| PointCloud2View::new(layout, &fields, data).map(|v| v.num_points()));
            assert_eq!(view(&data as &[u8]).unwrap(), 0);
        }
    }
}

//! Arrays of Arrow and of ndarray.

use std::sync::Arc;

use arrow_array::types::Float32Type;
use arrow_array::{Array, ArrayRef, FixedSizeListArray, Float64Array};
use snake_core::{ArrowPoints, Builtin, Model, Point, PointSource};

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
    let doubles: ArrayRef = Arc::new(Float64Array::from(vec![1.0]));
    for (array, name) in [(&pairs as &dyn Array, "2"), (&*doubles, "Float64")] {
        let error = ArrowPoints::new(array).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains("FixedSizeList<Float32, 3>"), "{error}");
    }
}

#[test]
fn arrays_have_the_values_of_their_positions() {
    let on_cylinder = |i: u16| {
        let angle = f32::from(i) * 0.1;
        [angle.cos(), angle.sin(), f32::from(i % 50) * 0.04]
    };
    let points: Vec<Point> = (0..2000).map(on_cylinder).collect();
    let model = Model::builtin(Builtin::Compact);
    let field = model.encode(&points, &Default::default()).unwrap();
    let grid = field.grid(9).unwrap();
    let array = grid.array(|queries| field.occupancy(queries)).unwrap();
    for (z, y, x) in [(0, 0, 0), (3, 5, 7), (8, 1, 4)] {
        let query = [grid.coordinate(0, x), grid.coordinate(1, y), grid.coordinate(2, z)];
        assert_eq!(array[[z, y, x]], field.occupancy(&[query]).unwrap()[0]);
    }
    assert!(grid.array(|_| Ok(vec![0.0])).unwrap_err().to_string().contains("9 for a grid"));
    let (volume, shape) = (field.volume(), field.volume().shape());
    let [_, height, width, channels] = shape;
    assert_eq!(volume.view().shape(), shape);
    let index = ((3 * height + 4) * width + 5) * channels + 6;
    assert_eq!(volume.view()[[3, 4, 5, 6]], volume.features()[index]);
}

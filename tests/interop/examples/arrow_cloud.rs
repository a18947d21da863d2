//! Keypoints of an Arrow array: `cargo run --release -p snake-interop --example arrow_cloud`.

use arrow_array::types::Float32Type;
use arrow_array::{Array, FixedSizeListArray};
use snake_core::{ArrowPoints, Builtin, Detection, FrameDetector, Model, Result};

/// A torus of 4000 points as FixedSizeList<f32, 3>. Every tenth point is null.
fn torus() -> FixedSizeListArray {
    let point = |i: u16| {
        let (u, v) = (f32::from(i) * 0.1, f32::from(i) * 0.7);
        let ring = 1.0 + 0.3 * v.cos();
        (!i.is_multiple_of(10)).then_some([ring * u.cos(), ring * u.sin(), 0.3 * v.sin()].map(Some))
    };
    FixedSizeListArray::from_iter_primitive::<Float32Type, _, _>((0..4000).map(point), 3)
}

/// Detects the keypoints of an array.
pub fn main() -> Result<()> {
    let array = torus();

    // Any Arrow array; another type than FixedSizeList<f32, 3> is an error that names it.
    let cloud = ArrowPoints::new(&array)?;

    let model = Model::builtin(Builtin::Compact);
    let options = *model.recommended();
    let mut detection = Detection::default();
    FrameDetector::new(model, options)?.detect_into(&cloud, &mut detection)?;
    assert_eq!(detection.num_skipped, 400);
    println!("{} keypoints of {} points", detection.keypoints.len(), array.len() - detection.num_skipped);
    Ok(())
}

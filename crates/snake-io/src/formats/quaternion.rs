//! Rotations as files store them.

/// The rotation of a quaternion `w x y z` of any length, row by row. Zeros, which writers use if no rotation is known,
/// give no rotation.
pub(crate) fn rotation(quaternion: [f64; 4]) -> Result<[[f64; 3]; 3], String> {
    let most = quaternion.into_iter().map(f64::abs).fold(0.0, f64::max);
    if !quaternion.iter().all(|v| v.is_finite()) {
        return Err(format!("a rotation by {quaternion:?}, which is not finite"));
    }
    if most == 0.0 {
        return Ok([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    }
    // The square of a large number would overflow, and that of a small number would be zero.
    let scaled = quaternion.map(|v| v / most);
    let length = scaled.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = scaled.map(|v| v / length);
    Ok([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ])
}

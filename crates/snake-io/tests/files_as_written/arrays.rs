//! NumPy arrays and sweeps.

use super::*;

/// An array with this description and shape.
fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let descr = if descr.starts_with('[') { descr.into() } else { format!("'{descr}'") };
    let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
    [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
}

#[test]
fn arrays_of_other_shapes_and_types() {
    assert_eq!(
        read("npy", &npy("<f2", "(1, 3)", &[0, 0x3c, 0, 0xc0, 0x55, 0x35])).unwrap(),
        [[1.0, -2.0, 0.333_251_95]]
    );
    let zeros = |number: usize| vec![0; 8 * number];
    assert_refused(
        "npy",
        [
            (npy("<f8", "(3, 300)", &zeros(900)), "numpy.save(\"cloud.npy\", a.T)"),
            (npy("<f8", "(4, 300)", &zeros(1200)), "4 points of 300 values; if it is 300 points"),
            (npy("<f8", "(4, 4)", &[zeros(15), 1.0_f64.to_le_bytes().to_vec()].concat()), "4 x 4 matrix"),
            (npy("<f8", "(2, 3, 3)", &zeros(18)), "a.reshape(-1, 3)"),
            (npy("[('x', '<f4'), ('y', '<f4'), ('z', '<f4')]", "(2,)", &zeros(3)), "a structured array"),
            (npy("|O", "(2, 3)", &zeros(6)), "a.astype(float)"),
            (npy("<f8", "(2, 3)", &[zeros(6), vec![1; 99]].concat()), "99 bytes are left over"),
        ],
    );
    assert_eq!(read_with("npy", &npy("<f8", "(3, 300)", &zeros(900)), &columns("1,2,3")).unwrap().len(), 3);
    assert_eq!(read("npy", &npy("<f8", "(3, 6)", &zeros(18))).unwrap().len(), 3);
}

/// A sweep over ground and a wall, with `values` float32 values a point: intensity, elongation and zeros.
fn sweep(values: usize) -> Vec<u8> {
    let random = |seed: usize| ((seed as f64 * 12.9898).sin() * 43758.5453).fract().abs() as f32;
    let point = |index: usize| {
        let (azimuth, elevation) = ((index / 16) as f32 * 0.0419, ((index % 16) as f32 * 1.33 - 15.0).to_radians());
        let ground = if elevation < 0.0 { 1.8 / (-elevation).tan() } else { 75.0 };
        let range = ground.min(12.0 / azimuth.sin().abs().max(0.05)).min(75.0) + random(index) * 0.02;
        let [x, y, z] = [range * azimuth.cos(), range * azimuth.sin(), range * elevation.tan()];
        [x, y, z, random(7 * index), 0.3 * random(3 * index), 0.1, 0.0, 0.0][..values].to_vec()
    };
    floats(&(0..2400).flat_map(point).collect::<Vec<f32>>())
}

#[test]
fn sweeps_with_other_numbers_of_values() {
    for (format, values) in
        [("kitti", 4), ("nuscenes", 5), ("kitti:3", 3), ("kitti:5", 5), ("kitti:6", 6), ("kitti:8", 8)]
    {
        let bytes = sweep(values);
        let points = read(format, &bytes).unwrap();
        assert_eq!(
            (points.len(), points[5][0]),
            (2400, f32::from_le_bytes(bytes[20 * values..][..4].try_into().unwrap()))
        );
    }
    for values in [3, 5, 6, 8] {
        let expected: &str = match values {
            3 => "`format` kitti:3",
            5 => "`format` kitti:5",
            6 => "`format` kitti:6",
            _ => "`format` kitti:8",
        };
        assert_refused("kitti", [(sweep(values), expected)]);
        assert_eq!(read("kitti:4", &sweep(values)).unwrap().len(), 600 * values);
    }
    assert_refused("nuscenes", [(sweep(4), "`format` kitti:4")]);
    assert_refused("kitti:4", [(sweep(5)[..20 * 2399].to_vec(), "what fits is `format` kitti:5")]);
    let doubles: Vec<u8> = POINTS
        .as_flattened()
        .iter()
        .cycle()
        .take(4000)
        .flat_map(|v| (f64::from(*v) * 1.1 + 0.01).to_le_bytes())
        .collect();
    assert_refused("kitti", [(doubles, "no float32 coordinates")]);
    // Every second return is missing.
    let gaps: Vec<u8> = sweep(4).chunks(16).flat_map(|point| [point, &[0; 16]].concat()).collect();
    assert_eq!(read("kitti", &gaps).unwrap().len(), 4800);
    for extension in ["kitti:2", "kitti:", "kitti:x", "kitti:65", "kitti:-1"] {
        assert!(PointFormat::from_extension(extension).is_none(), "{extension}");
    }
}

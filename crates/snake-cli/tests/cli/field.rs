//! `snake-cli field`: pictures and volumes.

use std::path::Path;

use snake_core::{Builtin, Field, Model, Point};
use snake_io as io;

use super::{file, report, sample, succeed};

fn sample_field() -> Field {
    let points = io::read_points(Path::new(&sample())).unwrap();
    let model = Model::builtin(Builtin::Compact);
    model.encode(&points, &model.recommended().encode).unwrap()
}

/// Width, height and the red channel of a PNG.
fn red(path: &str) -> (usize, usize, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let channels = info.color_type.samples();
    (info.width as usize, info.height as usize, pixels.iter().copied().step_by(channels).collect())
}

/// The header and the values of a `.npy` of `<f4`.
fn npy(path: &str) -> (String, Vec<f32>) {
    let bytes = std::fs::read(path).unwrap();
    let data = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let (values, _) = bytes[data..].as_chunks::<4>();
    (String::from_utf8_lossy(&bytes[10..data]).into(), values.iter().map(|v| f32::from_le_bytes(*v)).collect())
}

#[test]
fn a_volume_holds_the_field_at_the_printed_positions() {
    let folder = tempfile::tempdir().unwrap();
    let path = file(&folder, "volume.npy");
    let printed = report(&["field", &sample(), "-o", &path, "--resolution", "20", "--json"]);
    let (header, values) = npy(&path);
    assert!(header.contains("'<f4'") && header.contains("(20, 20, 20)") && header.contains("False"), "{header}");
    let place = |axis: usize, index: usize| {
        let [low, high] = ["low", "high"].map(|end| printed[end][axis].as_f64().unwrap());
        (low + index as f64 * (high - low) / 19.0) as f32
    };
    let queries: Vec<Point> =
        (0..20 * 20 * 20).map(|i| [place(0, i % 20), place(1, i / 20 % 20), place(2, i / 400)]).collect();
    let expected = sample_field().saliency(&queries).unwrap();
    assert_eq!(values.len(), expected.len());
    assert!(values.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-4));
    // The field is not constant there.
    assert!(expected.iter().any(|v| *v > 0.25) && expected.iter().any(|v| *v < 0.05));
}

/// Pixels of the image within a picture of one panel.
const LEFT: usize = 92;
const TOP: usize = 36;
const SIDE: usize = 440;

/// Compares a gray picture with values `[row][column]` from the lower left, linear between them.
fn assert_shows(path: &str, expected: &[f32], resolution: usize) {
    let (width, _, pixels) = red(path);
    for y in (0..SIDE).step_by(7) {
        for x in (0..SIDE).step_by(7) {
            let place = [x, SIDE - 1 - y].map(|i| i as f32 / (SIDE - 1) as f32 * (resolution - 1) as f32);
            let [column, row] = place.map(|v| (v as usize).min(resolution - 2));
            let [across, up] = [place[0] - column as f32, place[1] - row as f32];
            let at = |row: usize, column: usize| expected[row * resolution + column];
            let along = |row| at(row, column) * (1.0 - across) + at(row, column + 1) * across;
            let value = along(row) * (1.0 - up) + along(row + 1) * up;
            let shown = f32::from(pixels[(TOP + y) * width + LEFT + x]) / 255.0;
            assert!((shown - value).abs() < 0.004, "{path}: {shown} for {value} at {x}, {y}");
        }
    }
}

#[test]
fn pictures_show_slices_and_largest_values_of_the_volume() {
    let folder = tempfile::tempdir().unwrap();
    let volume = file(&folder, "volume.npy");
    let common = ["--quantity", "occupancy", "--resolution", "40"];
    let printed = report(&[&["field", &sample(), "-o", &volume, "--json"], &common[..]].concat());
    let (_, values) = npy(&volume);
    // Strides of x, y and z in the volume, and of each axis to look along those of the picture's columns and rows.
    let strides = [1, 40, 1600];
    for (axis, name, [across, up]) in [(0, "x", [1, 2]), (1, "y", [0, 2]), (2, "z", [0, 1])] {
        let plane = |along: &dyn Fn(usize) -> f32| -> Vec<f32> {
            (0..1600).map(|i| along(i % 40 * strides[across] + i / 40 * strides[up])).collect()
        };
        let largest = plane(&|start| (0..40).map(|i| values[start + i * strides[axis]]).fold(0.0, f32::max));
        let slice = plane(&|start| values[start + 25 * strides[axis]]);
        let [low, high] = ["low", "high"].map(|end| printed[end][axis].as_f64().unwrap());
        let position = (low + 25.0 * (high - low) / 39.0).to_string();
        for (expected, extra) in [(largest, vec![]), (slice, vec!["--slice", &position])] {
            let path = file(&folder, &format!("{name}{}.png", extra.len()));
            let gray = ["field", &sample(), "-o", &path, "--axis", name, "--colormap", "gray", "--no-points"];
            succeed(&[&gray[..], &common, &extra].concat());
            assert_shows(&path, &expected, 40);
        }
    }
}

#[test]
fn panels_form_rows_and_columns_and_points_are_optional() {
    let folder = tempfile::tempdir().unwrap();
    let draw = |name: &str, extra: &[&str]| {
        let path = file(&folder, name);
        succeed(&[&["field", &sample(), "-o", &path, "--resolution", "16"], extra].concat());
        red(&path)
    };
    let (width, height, dotted) = draw("one.png", &[]);
    let (_, _, plain) = draw("plain.png", &["--no-points"]);
    assert!(dotted.iter().zip(&plain).filter(|(a, b)| a != b).count() > 1000);
    let (wide, high, _) = draw("six.png", &["--quantity", "occupancy,saliency", "--axis", "x,y,z"]);
    assert!(high == 2 * height && wide > 2 * width && wide < 3 * width);
    // No point is near the edge of the box.
    let far = ["--axis", "z", "--slice", "-0.8"];
    assert_eq!(draw("far.png", &far), draw("far_plain.png", &[&far[..], &["--no-points"]].concat()));
    assert_ne!(draw("middle.png", &["--slice", "middle"]), draw("m.png", &["--slice", "middle", "--no-points"]));
    assert_ne!(draw("viridis.png", &["--colormap", "viridis"]).2, dotted);
    let reds = draw("reds.png", &["--colormap", "reds", "--no-points"]).2;
    // Without saliency the map is bright.
    assert!(reds[(TOP + 3) * width + LEFT + 3] > 240 && reds.iter().any(|red| *red < 200));
}

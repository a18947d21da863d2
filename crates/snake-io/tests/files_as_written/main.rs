//! Files as other programs write them: what is read, what is refused, and which advice a refusal gives.

mod arrays;
mod points_and_meshes;
mod text;

use snake_core::Point;
use snake_io::{PointFormat, ReadOptions, parse_cloud};

const POINTS: [Point; 6] = [
    [1.087, -0.054, 0.312],
    [-0.5, 2.25, 7.0],
    [3.125, 0.001, -4.5],
    [0.0, 12.5, 1.75],
    [8.5, -6.0, 0.054],
    [-2.0, 0.25, 9.5],
];

/// The points in rows of text.
fn rows(separator: &str, end: &str) -> String {
    POINTS.iter().map(|point| point.map(|v| format!("{v:.3}")).join(separator) + end).collect()
}

/// Rows of `FORMAT`, in which X, Y and Z stand for the coordinates and N for the number of the row from 0.
fn lines(format: &str) -> String {
    let line = |(number, [x, y, z]): (usize, Point)| {
        let numbers = [("X", x), ("Y", y), ("Z", z)];
        let line = format.replace('N', &number.to_string());
        numbers.iter().fold(line, |line, (axis, v)| line.replace(axis, &format!("{v:.3}"))) + "\n"
    };
    (0..).zip(POINTS).map(line).collect()
}

fn read_with(format: &str, bytes: &[u8], options: &ReadOptions) -> Result<Vec<Point>, String> {
    let format = PointFormat::from_extension(format).unwrap();
    parse_cloud(bytes, format, options).map(|cloud| cloud.into_points()).map_err(|error| error.to_string())
}

fn read(format: &str, bytes: &[u8]) -> Result<Vec<Point>, String> {
    read_with(format, bytes, &ReadOptions::default())
}

fn columns(columns: &str) -> ReadOptions {
    ReadOptions::default().with_columns(Some(columns.parse().unwrap()))
}

/// Checks that all these contents hold [`POINTS`].
#[track_caller]
fn assert_read<B: AsRef<[u8]>>(format: &str, contents: impl IntoIterator<Item = B>) {
    for content in contents {
        let shown = String::from_utf8_lossy(&content.as_ref()[..content.as_ref().len().min(200)]).into_owned();
        let points = read(format, content.as_ref()).unwrap_or_else(|reason| panic!("{reason}\n{shown}"));
        assert_eq!(points, POINTS, "{shown}");
    }
}

/// Checks that these contents are refused with these words.
#[track_caller]
fn assert_refused<B: AsRef<[u8]>>(format: &str, contents: impl IntoIterator<Item = (B, &'static str)>) {
    for (content, expected) in contents {
        let shown = String::from_utf8_lossy(&content.as_ref()[..content.as_ref().len().min(200)]).into_owned();
        let reason = read(format, content.as_ref()).map(|points| points.len()).expect_err(&shown);
        assert!(reason.contains(expected), "{reason}\n{shown}");
    }
}

/// The coordinates in the header of a PLY file.
const PLY_AXES: &str = "property float x\nproperty float y\nproperty float z\n";

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

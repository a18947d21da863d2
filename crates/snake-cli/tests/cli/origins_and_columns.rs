//! Columns of coordinates and clouds far from zero, in every command.

use serde_json::Value;
use snake_core::{Point, add_origin};
use snake_io::{Cloud, ReadOptions, read_cloud, read_points, write_points};
use tempfile::TempDir;

use super::{sample, snake, succeed};

/// A whole number of metres, as those of a UTM zone.
const FAR: [f64; 3] = [691_000.0, 5_336_000.0, 512.0];

/// The sample near zero and far from it, as `near.npy` and `far.npy`.
struct Clouds(TempDir);

impl Clouds {
    fn new() -> Self {
        let clouds = Self(tempfile::tempdir().unwrap());
        let points = read_points(sample().as_ref()).unwrap();
        write_points(clouds.path("near.npy").as_ref(), &points, [0.0; 3]).unwrap();
        write_points(clouds.path("far.npy").as_ref(), &points, FAR).unwrap();
        clouds
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    fn positions(&self, name: &str) -> Vec<[f64; 3]> {
        let Cloud { points, origin } = read_cloud(self.path(name).as_ref(), &ReadOptions::default()).unwrap();
        points.into_iter().map(|point| add_origin(point, origin)).collect()
    }
}

/// The JSON that a successful command prints, and its standard error.
fn report(arguments: &[&str]) -> (Value, String) {
    let output = snake(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {said}");
    (serde_json::from_slice(&output.stdout).unwrap(), said)
}

fn numbers(value: &Value) -> [f64; 3] {
    std::array::from_fn(|axis| value[axis].as_f64().unwrap_or_else(|| panic!("three numbers: {value}")))
}

fn assert_moved(near: [f64; 3], far: [f64; 3], by: [f64; 3]) {
    for axis in 0..3 {
        assert!((near[axis] + by[axis] - far[axis]).abs() < 1e-3, "{near:?} {far:?}");
    }
}

#[test]
fn a_pcd_of_far_keypoints_reports_its_origin() {
    let clouds = Clouds::new();
    let (keypoints, aligned) = (clouds.path("k.pcd"), clouds.path("aligned.pcd"));
    let (json, said) = report(&["detect", &clouds.path("far.npy"), "--json", "-o", &keypoints]);
    let origin = numbers(&json["output_origin"]);
    assert!(origin[1] > 5e6 && said.contains("relative to the origin"), "{said}");
    let bytes = std::fs::read(&keypoints).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.contains("FIELDS x y z rgb") && text.contains("\nSIZE 4 4 4 4"), "{text:.300}");
    let start = bytes.windows(12).position(|piece| piece == b"DATA binary\n").unwrap() + 12;
    let number = |axis: usize| f32::from_le_bytes(bytes[start + 4 * axis..][..4].try_into().unwrap());
    let first = ["x", "y", "z"].map(|axis| json["keypoints"][0][axis].as_f64().unwrap());
    assert_moved([0, 1, 2].map(|axis| f64::from(number(axis))), first, origin);
    // A reader of our comment gets the whole positions.
    assert_moved(clouds.positions("k.pcd")[0], first, [0.0; 3]);

    let (json, said) = report(&["detect", &clouds.path("near.npy"), "--json", "-o", &keypoints]);
    assert_eq!((numbers(&json["output_origin"]), said.as_str()), ([0.0; 3], ""));
    let pair = [&clouds.path("near.npy")[..], &clouds.path("far.npy")];
    let (json, said) = report(&["register", pair[0], pair[1], "--json", "--aligned", &aligned]);
    assert!(numbers(&json["aligned_origin"])[1] > 5e6 && said.contains("relative to the origin"), "{json} {said}");
}

#[test]
fn every_command_keeps_the_precision_of_far_clouds() {
    let clouds = Clouds::new();
    let (near, far) = (clouds.path("near.npy"), clouds.path("far.npy"));
    for extension in ["ply", "obj"] {
        let mesh = |name: &str, input: &str| {
            let file = format!("{name}.{extension}");
            let (json, _) = report(&["reconstruct", input, "-o", &clouds.path(&file), "--resolution", "24", "--json"]);
            (json["triangles"].as_u64().unwrap(), clouds.positions(&file))
        };
        let ((triangles, vertices), (far_triangles, far_vertices)) = (mesh("m", &near), mesh("n", &far));
        assert_eq!((triangles, vertices.len()), (far_triangles, far_vertices.len()), "{extension}");
        vertices.into_iter().zip(far_vertices).for_each(|(near, far)| assert_moved(near, far, FAR));
    }
    let stl = clouds.path("m.stl");
    let (json, said) = report(&["reconstruct", &far, "-o", &stl, "--resolution", "24", "--json"]);
    assert!(numbers(&json["output_origin"])[0] > 6e5 && said.contains("relative to the origin"), "{said}");

    let field = |input: &str, slice: &str| {
        let picture = clouds.path("field.png");
        let options = ["--resolution", "16", "--axis", "y", "--slice", slice, "--json"];
        report(&[&["field", input, "-o", &picture], &options[..]].concat()).0
    };
    let (near_field, far_field) = (field(&near, "0"), field(&far, "5336000"));
    assert_moved(numbers(&near_field["low"]), numbers(&far_field["low"]), FAR);
    assert_moved(numbers(&near_field["high"]), numbers(&far_field["high"]), FAR);

    let page = clouds.path("page.html");
    succeed(&["view", &near, &far, "-o", &page, "--max-keypoints", "40"]);
    let html = std::fs::read_to_string(&page).unwrap();
    let data = html.split("id=\"data\">").nth(1).unwrap().split("</script>").next().unwrap();
    let data: Value = serde_json::from_str(data).unwrap();
    let [low, far_low] = [0, 1].map(|cloud| numbers(&data["clouds"][cloud]["points"]["low"]));
    assert_moved(low, far_low, FAR);
    let shift: [f64; 3] = std::array::from_fn(|axis| data["pair"]["t_first_second"][axis][3].as_f64().unwrap());
    assert!((0..3).all(|axis| (shift[axis] + FAR[axis]).abs() < 0.05), "{shift:?}");
}

/// The sample as text below a header.
fn table(path: &str, header: &str, row: impl Fn(Point) -> String) {
    let rows: Vec<String> = read_points(sample().as_ref()).unwrap().into_iter().map(row).collect();
    std::fs::write(path, format!("{header}\n{}\n", rows.join("\n"))).unwrap();
}

#[test]
fn columns_can_be_chosen_in_every_command() {
    let clouds = Clouds::new();
    let (told, untold) = (clouds.path("paraview.csv"), clouds.path("untold.csv"));
    table(&told, "\"ring\",\"range\",\"Points:0\",\"Points:1\",\"Points:2\"", |[x, y, z]| format!("1,2,{x},{y},{z}"));
    table(&untold, "time,e,n,h", |[x, y, z]| format!("9,{x},{y},{z}"));
    let near = clouds.path("near.npy");
    let (expected, _) = report(&["detect", &near, "--json"]);
    assert_eq!(report(&["detect", &told, "--json"]).0["keypoints"], expected["keypoints"]);
    for columns in ["e,n,h", "2,3,4"] {
        assert_eq!(report(&["detect", &untold, "--json", "--columns", columns]).0["keypoints"], expected["keypoints"]);
    }
    let refused = snake(&["register", &untold, &near]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("--columns x,y,z") && said.contains("2 `e`"), "{said}");
    let (mesh, page) = (clouds.path("mesh.ply"), clouds.path("page.html"));
    for command in
        [&["register", &untold, &untold][..], &["reconstruct", &untold, "-o", &mesh], &["view", &untold, "-o", &page]]
    {
        succeed(&[command, &["--columns", "e,n,h"]].concat());
    }
    for (columns, expected) in [("e,n,up", "no column `up`"), ("1,2", "three names"), ("0,1,2", "begin at 1")] {
        let output = snake(&["detect", &untold, "--columns", columns]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(expected), "{said}");
    }
}

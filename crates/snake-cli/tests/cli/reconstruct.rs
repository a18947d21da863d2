//! `snake-cli reconstruct`.

use tempfile::TempDir;

use super::{json_lines, sample, snake, stderr};

#[test]
fn meshes_are_written_in_each_format() {
    let folder = TempDir::new().unwrap();
    let reconstruct = |name: &str, more: &[&str]| {
        let path = folder.path().join(name);
        let output =
            snake(&[&["reconstruct", &sample(), "-o", path.to_str().unwrap(), "--resolution", "48"], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        (std::fs::read(path).unwrap(), output)
    };
    let (ply, output) = reconstruct("a.ply", &["--json", "--threads", "1"]);
    let report = &json_lines(&output)[0];
    let number = |key: &str| report[key].as_u64().unwrap() as usize;
    let (vertices, triangles) = (number("vertices"), number("triangles"));
    assert!(triangles > 500 && number("num_points") == 4096, "{report}");
    assert!(report["timing_seconds"]["mesh"].as_f64().unwrap() > 0.0);
    let written = snake_io::read_points(&folder.path().join("a.ply")).unwrap();
    assert_eq!(written.len(), vertices);
    let scale = report["normalization"]["scale"].as_f64().unwrap();
    // The surface of a thin shell: both sides of an object that touches the sphere of this diameter.
    let area = report["area"].as_f64().unwrap() / (scale * scale);
    assert!((0.1..3.0).contains(&area), "{area}");
    assert_eq!(reconstruct("b.ply", &["--threads", "2"]).0, ply, "the number of threads matters");

    let (stl, output) = reconstruct("c.STL", &["--outer"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let outer = (stl.len() - 84) / 50;
    assert!(outer > 100 && outer <= triangles, "{outer}");
    assert!(text.contains(&format!(" {outer} triangles")) && text.contains("written to"), "{text}");

    let (obj, _) = reconstruct("d.obj", &[]);
    let lines = |prefix: &str| String::from_utf8_lossy(&obj).lines().filter(|line| line.starts_with(prefix)).count();
    assert_eq!((lines("v "), lines("vn "), lines("f ")), (vertices, vertices, triangles));

    let (_, output) = reconstruct("e.ply", &["--level", "0.999"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains("0 triangles, area 0.0") && stderr(&output).contains("no surface: a lower `level`"),
        "{text}"
    );
}

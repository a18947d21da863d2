//! `snake-cli align`.

use std::path::Path;

use serde_json::Value;

use super::{json_lines, report, sample, snake, stderr, succeed, write_npy};

/// Two samplings of the sample that share half of their points, the second rotated by a quarter about z and moved by (3, 0, -1), and a cube, as files in
/// `folder/scans`.
fn scans(folder: &Path) -> String {
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let without = |rest: usize| points.iter().enumerate().filter(move |(i, _)| i % 3 != rest).map(|(_, point)| *point);
    let first: Vec<_> = without(0).collect();
    let second: Vec<_> = without(1).map(|p| [3.0 - p[1], p[0], p[2] - 1.0]).collect();
    let on_cube = |i: usize| {
        let (a, b) = ((i % 40) as f32 / 40.0, (i / 40 % 40) as f32 / 40.0);
        [[a, b, 0.0], [a, 1.0, b], [0.0, a, b]][i % 3]
    };
    let cube: Vec<_> = (0..1600).map(on_cube).collect();
    let scans = folder.join("scans");
    std::fs::create_dir(&scans).unwrap();
    for (name, points) in [("a.ply", &first), ("b.npy", &second), ("c.pcd", &cube)] {
        snake_io::write_points(&scans.join(name), points, [0.0; 3]).unwrap();
    }
    scans.display().to_string()
}

#[test]
fn merged_and_aligned_clouds_keep_colours_intensity_and_rotated_normals() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name).display().to_string();
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let attributes = |normal: [f32; 3]| {
        let mut attributes = snake_io::Attributes::default();
        attributes.colors = Some((0..points.len()).map(|i| [(i % 256) as u8, 2, 3]).collect());
        attributes.intensity = Some((0..points.len()).map(|i| i as f32).collect());
        attributes.normals = Some(vec![normal; points.len()]);
        attributes
    };
    let rotated: Vec<_> = points.iter().map(|p| [3.0 - p[1], p[0], p[2] - 1.0]).collect();
    let [target, source] = [file("target.ply"), file("source.pcd")];
    // The normal of the source is x there, which is -y in the target's frame.
    snake_io::write_cloud(target.as_ref(), &points, &attributes([0.0, 0.0, 1.0]), [0.0; 3]).unwrap();
    snake_io::write_cloud(source.as_ref(), &rotated, &attributes([1.0, 0.0, 0.0]), [0.0; 3]).unwrap();
    let is_right = |normal: &[f32; 3]| (normal[1] + 1.0).abs() < 0.01 && normal[0].abs() < 0.1;
    for aligned in ["aligned.ply", "aligned.pcd", "aligned.csv"].map(file) {
        succeed(&["register", &source, &target, "--aligned", &aligned]);
        let kept = snake_io::read_attributes(aligned.as_ref(), None, points.len()).unwrap();
        assert_eq!((&kept.colors, &kept.intensity), (&attributes([0.0; 3]).colors, &attributes([0.0; 3]).intensity));
        assert!(kept.normals.unwrap().iter().all(is_right), "{aligned}");
    }
    let merged = file("merged.ply");
    succeed(&["align", &target, &source, "--merged", &merged]);
    let kept = snake_io::read_attributes(merged.as_ref(), None, 2 * points.len()).unwrap();
    let normals = kept.normals.unwrap();
    assert!(normals[0] == [0.0, 0.0, 1.0] && is_right(&normals[points.len()]), "{:?}", normals[points.len()]);
    assert_eq!(kept.intensity.unwrap()[points.len() + 7], 7.0);
    assert_eq!(kept.colors.unwrap().len(), 2 * points.len());
}

#[test]
fn align_writes_poses_and_the_merged_cloud() {
    let folder = tempfile::tempdir().unwrap();
    let scans = scans(folder.path());
    let file = |name: &str| folder.path().join(name).display().to_string();
    let (poses, merged) = (file("poses.json"), file("map.ply"));
    let report = report(&["align", &scans, "-o", &poses, "--merged", &merged, "--json"]);
    assert_eq!(report, serde_json::from_slice::<Value>(&std::fs::read(&poses).unwrap()).unwrap());
    assert_eq!(report["parts"], serde_json::json!([[0, 1], [2]]));
    assert!(report["clouds"][1].as_str().unwrap().ends_with("b.npy"));
    let expected = [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 3.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]];
    for (row, expected) in expected.iter().enumerate() {
        for (column, expected) in expected.iter().enumerate() {
            let value = report["poses"][1]["t_part_cloud"][row][column].as_f64().unwrap();
            assert!((value - expected).abs() < 0.03, "{report}");
        }
    }
    // The two samplings lie on each other again.
    let points = snake_io::read_points(Path::new(&sample())).unwrap();
    let map = snake_io::read_points(Path::new(&merged)).unwrap();
    let second: Vec<_> = points.iter().enumerate().filter(|(i, _)| i % 3 != 1).map(|(_, point)| *point).collect();
    assert_eq!(map.len(), points.iter().enumerate().filter(|(i, _)| i % 3 != 0).count() + second.len());
    for (p, q) in second.iter().zip(&map[map.len() - second.len()..]) {
        assert!((0..3).all(|axis| (p[axis] - q[axis]).abs() < 0.05), "{p:?} {q:?}");
    }
    let text = snake(&["align", &scans, "--require-connected"]);
    let printed = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(text.status.code() == Some(1) && stderr(&text).contains("2 parts"), "{}", stderr(&text));
    assert!(printed.contains("3 clouds in 2 parts") && printed.contains("a.ply"), "{printed}");
}

#[test]
fn initial_poses_are_read_and_what_contradicts_them_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let scans = scans(folder.path());
    let file = |name: &str| folder.path().join(name).display().to_string();
    let (poses, trajectory) = (file("poses.json"), file("poses.txt"));
    succeed(&["align", &scans, "-o", &poses]);
    // The poses of an earlier run: the cube is in a part of its own.
    let output = snake(&["align", &scans, "--initial-poses", &poses, "--json"]);
    assert!(output.status.success() && stderr(&output).contains("no pose of 1 of 3 clouds"), "{}", stderr(&output));
    let report = &json_lines(&output)[0];
    assert!(report["parts"] == serde_json::json!([[0, 1], [2]]) && report["contradictions"] == serde_json::json!([]));
    // By these, the second is 1 higher.
    std::fs::write(&trajectory, "1 0 0 0 0 1 0 0 0 0 1 0\n0 1 0 0 -1 0 0 3 0 0 1 2\n1 0 0 0 0 1 0 0 0 0 1 5\n")
        .unwrap();
    let report = |options: &[&str]| {
        let output = snake(&[&["align", &scans, "--initial-poses", &trajectory], options].concat());
        String::from_utf8(output.stdout).unwrap()
    };
    let (left_out, allowed) = (report(&[]), report(&["--pose-tolerance", "2"]));
    let is_named = left_out.contains("left out: ") && left_out.contains("b.npy to ");
    assert!(is_named && left_out.contains("in 3 parts") && allowed.contains("in 2 parts"), "{left_out}{allowed}");
}

#[test]
fn a_cloud_that_cannot_be_aligned_is_named_by_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let bad = folder.path().join("bad.npy");
    for points in [&[f32::NAN; 6][..], &[1.0; 6], &[]] {
        write_npy(&bad, &[points.len() / 3, 3], points);
        let done = snake(&["align", &sample(), &sample(), &bad.display().to_string()]);
        assert!(!done.status.success() && stderr(&done).contains("bad.npy: "), "{}", stderr(&done));
    }
}

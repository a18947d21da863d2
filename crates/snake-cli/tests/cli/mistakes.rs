//! Mistakes on the command line and in its files.

use super::{assert_refused, sample, snake, stderr};

#[test]
fn names_and_values_of_any_length_are_told_in_a_short_line() {
    let long = format!("begin{}end", "é".repeat(50_000));
    let folder = tempfile::tempdir().unwrap();
    let list = folder.path().join("list.txt");
    std::fs::write(&list, "é".repeat(5_000_000) + ".ply").unwrap();
    let list = list.display().to_string();
    let cases: &[&[&str]] = &[
        &["detect", &long],
        &["detect", &format!("{long}.ply")],
        &["detect", &sample(), "--model", &long],
        &["detect", &sample(), "--set", &format!("{long}=1")],
        &["detect", &sample(), "--set", &format!("nms_radius={long}")],
        &["detect", &sample(), &format!("--{long}")],
        &["detect", &sample(), "-o", &format!("{long}.ply")],
        &["detect", "--input-list", &list],
        &["register", &long, &sample()],
    ];
    for arguments in cases {
        let output = snake(arguments);
        let said = stderr(&output);
        assert!(!output.status.success() && said.len() < 8000, "{}: {}", arguments[0], said.len());
        assert!(said.contains('…') && (said.contains("end") || said.contains("é.ply")), "{said}");
    }
}

#[test]
fn each_mistake_gets_one_line_with_advice() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path.display().to_string()
    };
    let (one, same) = (file("one.xyz", "1 2 3\n"), file("same.xyz", &"1 2 3\n".repeat(9)));
    let (nan, empty, weights) =
        (file("nan.xyz", "nan nan nan\nnan 0 0\n"), file("empty.xyz", ""), file("w.safetensors", "junk"));
    let nothing = folder.path().join("none").display().to_string();
    let cases: &[(&[&str], &str)] = &[
        (&["detect", "nowhere.ply"], "nowhere.ply"),
        (&["detect", &one], "at least two different"),
        (&["detect", &nan], "none of the 2 points is finite"),
        (&["detect", &file("far.xyz", "0 0 0\n1e38 0 0\n")], "allowed is 1e-15 to 1e15"),
        (&["detect", &sample(), "--sample", "100", "--input-format", "xyz"], "the content is PLY"),
        (&["detect", &same, "--sample", "100"], "no faces"),
        (&["detect", &sample(), "--sample", "0"], "1..=100000000"),
        (&["detect", &sample(), "--input-format", "doc"], "known are ply"),
        (&["detect", &file("a.spz", "x")], "splat-transform FILE FILE.ply"),
        (&["detect", &file("a.splat", "x")], "splat-transform FILE FILE.ply"),
        (&["detect", &file("a.3mf", "x")], "assimp export FILE FILE.ply"),
        (&["detect", &file("a.ply.gz", "x")], "gunzip --keep FILE"),
        (&["detect", &file("a.lvx", "x")], "Livox Viewer"),
        (&["detect", &sample(), &sample(), "-o", "-"], "one input only"),
        (&["detect", "-", "-"], "only once"),
        (&["detect", "-"], "give --input-format"),
        (&["register", "-", "-"], "only once"),
        (&["detect", &empty], "no points"),
        (&["detect", &weights], "extension"),
        (&["detect", &sample(), "-o", "k.docx"], "k.docx"),
        (&["detect", &sample(), "-o", &sample()], "is an input"),
        (&["detect", &sample(), "--model", &weights], "safetensors"),
        (&["detect", &sample(), "--preset", "kitti"], "modelnet40"),
        (&["detect", &sample(), "--set", "refine_method=newton"], "gradient-descent"),
        (&["detect", &sample(), "--set", "query_resolution=0"], "1 to 256"),
        (&["detect", &sample(), "--threads", "65535"], "--threads is 65535: allowed is 1 to"),
        (&["detect", &nothing], "none: No such file or directory"),
        (&["detect", "scans/"], "scans/: No such file or directory"),
        (&["align", "scans/"], "scans/: No such file or directory"),
        (&["view", "scans", "-o", "v.html"], "scans: No such file or directory"),
        (&["register", &sample()], "<TARGET>"),
        (&["register", "nowhere.ply", &sample()], "nowhere.ply"),
        (&["register", &nan, &sample()], "source: none of the 2 points is finite"),
        (&["register", &sample(), &sample(), "-o", "t.ply"], ".json, .txt"),
        (&["register", &sample(), &sample(), "--aligned", "a.txt"], ".ply"),
        (&["register", &sample(), &sample(), "--aligned", &sample()], "is an input"),
        (&["register", &sample(), &sample(), "--model", &weights], "safetensors"),
        (&["register", &sample(), &sample(), "--set", "descriptor=shot"], "fpfh"),
        (&["register", &sample(), &sample(), "--detector", "orb"], "harris3d"),
        (&["register", &sample(), &sample(), "--voxel-size", "0"], "voxel_size"),
        (&["model", &weights], "safetensors"),
    ];
    for (arguments, expected) in cases {
        let output = snake(arguments);
        assert_refused(&output, expected);
        assert!(!stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
    }
}

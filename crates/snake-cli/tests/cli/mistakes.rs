//! Mistakes on the command line and in its files.

use super::{assert_refused, root, sample, snake, stderr};

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
    let (plane, drive) = (&sample(), &root().join("tests/data/io/drive.mcap").display().to_string());
    let [png, npy, html, ply, csv] =
        ["png", "npy", "html", "ply", "csv"].map(|extension| format!("{}/out.{extension}", nothing));
    let (matrix, list) = (file("t.txt", "1 0 0\n"), file("list.txt", "\n"));
    let [bag, db3] = ["old.bag", "old.db3"].map(|name| file(name, "of another program"));
    let tiles = ["detect", &one, "-o", &csv, "--tile", "4"];
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
        (&["detect", &sample(), "--threads", "0"], "--threads is 0: allowed is 1 to"),
        (&["detect", &sample(), "--nms-radius", "-1"], "option `nms_radius` is -1: allowed is 0 or more"),
        (&["detect", &nothing], "none: No such file or directory"),
        (&["align", "scans/"], "scans/: No such file or directory"),
        (&["view", "scans", "-o", "v.html"], "scans: No such file or directory"),
        (&["register", "nowhere.ply", &sample()], "nowhere.ply"),
        (&["register", &nan, &sample()], "source: none of the 2 points is finite"),
        (&["register", &sample(), &sample(), "-o", "t.ply"], ".json, .txt"),
        (&["register", &sample(), &sample(), "--aligned", "a.txt"], ".ply"),
        (&["register", &sample(), &sample(), "--aligned", &sample()], "is an input"),
        (&["register", &sample(), &sample(), "--set", "descriptor=shot"], "fpfh"),
        (&["register", &sample(), &sample(), "--detector", "orb"], "harris3d"),
        (&["register", &sample(), &sample(), "--voxel-size", "0"], "voxel_size"),
        (&["model", &weights], "safetensors"),
        (&["reconstruct", plane, "-o", "mesh.xyz"], ".ply, .obj, .stl"),
        (&["reconstruct", plane, "-o", &ply, "--resolution", "1000000"], "allowed is 8 to 512"),
        (&["field", plane, "-o", "a.jpg"], ".png, .npy"),
        (&["field", plane, "-o", plane], "is an input"),
        (&["field", "nowhere.ply", "-o", &png], "nowhere.ply"),
        (&["field", plane, "-o", &npy, "--quantity", "occupancy,saliency"], "one --quantity"),
        (&["field", plane, "-o", &png, "--slice", "7"], "from -0.8"),
        (&["field", plane, "-o", &png, "--slice", "nan"], "`middle`"),
        (&["view", plane, plane, "-o", &html, "--annotations", plane], "cannot be used with"),
        (&["view", plane, "-o", "a.pdf"], ".html"),
        (&["register", plane, plane, "--view", "a.pdf"], ".html"),
        (&["view", plane, "-o", &html, "--epsilon", "1"], "two clouds"),
        (&["view", plane, plane, "-o", &html, "--transform", &matrix], "four rows of four numbers"),
        (&["view", plane, plane, "-o", &html, "--epsilon=-1"], "epsilon"),
        (&["view", plane, "nowhere.ply", "-o", &html], "nowhere.ply"),
        (&["align", plane, plane, "-o", "poses.txt"], ".json"),
        (&["align", plane, plane, "--merged", "map.las"], "las"),
        (&["align", plane], "2 to 500"),
        (&["align", plane, plane, "--merged", plane], "overwrite"),
        // Options of one pair are no options of many clouds.
        (&["align", plane, plane, "--set", "source_viewpoint=[0,0,0]"], "unknown option `source_viewpoint`"),
        (&["align", plane, plane, "--set", "hypotheses=3"], "unknown option `hypotheses`"),
        (&["align", plane, plane, "--initial-poses", &matrix], "line 1: expected"),
        (&["align", plane, plane, "--initial-poses", "poses.csv"], ".json, .txt, .tum"),
        (&[&tiles[..], &["--nms-radius", "3%"]].concat(), "nms_radius"),
        (&[&tiles[..], &["--json"]].concat(), "--json"),
        (&["detect", "-", "-o", &csv, "--tile", "4"], "standard input"),
        (&["detect", drive, "-o", &csv, "--tile", "4"], "recording"),
        (&["detect", "--input-list", &list], "the list of inputs is empty"),
        (&["detect", "--input-list", "nowhere.txt"], "cannot read nowhere.txt"),
        (&["detect", "-", "--input-list=-"], "only once"),
        (&["detect", "--json", "-q"], "required"),
        (&["detect", drive, plane], "a recording has to be the only input"),
        (&["detect", plane, "--topic", "/points"], "--topic is for a recording"),
        (&["detect", drive, "--topic", "/other"], "no messages of the topic /other; topics with point clouds: /points"),
        (&["detect", drive, "-o", &ply], "give a directory"),
        (&["detect", drive, "-o", "-"], "give a directory"),
        (&["detect", drive, "-o", drive], "is an input"),
        (&["detect", drive, "--sample", "9"], "not for a recording"),
        (&["view", drive, "-o", &html], "`snake-cli detect` read"),
        (&["detect", "none.bag"], "none.bag: No such file"),
        (&["detect", "none.db3"], "none.db3: "),
        (&["detect", &bag], "mcap convert FILE.bag FILE.mcap"),
        (&["detect", &db3], "ros2 bag convert -i FOLDER"),
    ];
    for (arguments, expected) in cases {
        let output = snake(arguments);
        assert_refused(&output, expected);
        assert!(!stderr(&output).contains("panicked"), "{arguments:?}: {}", stderr(&output));
    }
    assert!(!std::path::Path::new(&nothing).exists(), "nothing is written");
}

//! `snake-cli view`: pages for the browser.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use snake_core::{Point, RigidTransform};
use snake_io as io;
use snake_registration::transform_points;
use tempfile::TempDir;

use super::{assert_refused, file, sample, snake, succeed};

/// The data within a page.
fn page_data(path: &str) -> Value {
    let page = std::fs::read_to_string(path).unwrap();
    let (_, rest) = page.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

const SHIFTED_TURN: [[f64; 4]; 4] =
    [[0.0, -1.0, 0.0, 5.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]];

/// The sample, rotated and moved.
fn rotated(folder: &TempDir) -> String {
    let path = folder.path().join("rotated.ply");
    let points = io::read_points(Path::new(&sample())).unwrap();
    io::write_points(&path, &transform_points(&RigidTransform::from_matrix(SHIFTED_TURN).unwrap(), &points), [0.0; 3])
        .unwrap();
    path.display().to_string()
}

#[test]
fn annotations_are_shown_beside_the_keypoints() {
    let folder = tempfile::tempdir().unwrap();
    let (page, list) = (file(&folder, "page.html"), file(&folder, "plane.json"));
    let shape = |model_id: &str, indices: [usize; 2]| {
        let marked = indices.map(|index| serde_json::json!({"pcd_info": {"point_index": index}, "semantic_id": 3}));
        serde_json::json!({"class_id": "0", "model_id": model_id, "keypoints": marked})
    };
    let stem = Path::new(&sample()).file_stem().unwrap().to_string_lossy().into_owned();
    let view = |shapes: Value| {
        std::fs::write(&list, shapes.to_string()).unwrap();
        snake(&["view", &sample(), "-o", &page, "--annotations", &list])
    };
    assert!(view(serde_json::json!([shape("other", [0, 1]), shape(&stem, [7, 4000])])).status.success());
    let points = io::read_points(Path::new(&sample())).unwrap();
    let shown: Vec<Point> = serde_json::from_value(page_data(&page)["clouds"][0]["annotations"].clone()).unwrap();
    assert_eq!(shown, [points[7], points[4000]]);
    assert_refused(&view(serde_json::json!([shape("a", [0, 1]), shape("b", [0, 1])])), &format!("model_id {stem}"));
    assert_refused(&view(serde_json::json!([shape("a", [0, 99999])])), "point_index 99999");
}

#[test]
fn keypoints_within_epsilon_are_linked() {
    let folder = tempfile::tempdir().unwrap();
    let (page, given, json) = (file(&folder, "pair.html"), file(&folder, "given.html"), file(&folder, "t.json"));
    let second = rotated(&folder);
    let options = ["--max-keypoints", "20", "--epsilon", "0.05"];
    let printed = succeed(&[&["view", &sample(), &second, "-o", &page], &options[..]].concat());
    let data = page_data(&page);
    let pair = &data["pair"];
    let t: RigidTransform = serde_json::from_value(pair["t_first_second"].clone()).unwrap();
    let keypoints = |cloud: usize| -> Vec<Point> {
        let rows = data["clouds"][cloud]["keypoints"].as_array().unwrap().iter();
        rows.map(|row| ["x", "y", "z"].map(|axis| row[axis].as_f64().unwrap() as f32)).collect()
    };
    let second_in_first = transform_points(&t, &keypoints(1));
    let mut expected = Vec::new();
    for (i, a) in keypoints(0).iter().enumerate() {
        let distance = |b: &Point| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f32>().sqrt();
        let distances = second_in_first.iter().map(distance).enumerate();
        let (j, least) = distances.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        if least < 0.05 {
            expected.push([i, j]);
        }
    }
    let links: Vec<[usize; 2]> =
        pair["links"].as_array().unwrap().iter().map(|l| [0, 1].map(|end| l[end].as_u64().unwrap() as usize)).collect();
    assert_eq!(links, expected);
    assert!(links.len() > 5, "a rotated copy has keypoints at the same places");
    assert!(printed.contains(&format!("{} of 20 keypoints repeat within 0.0500", links.len())), "{printed}");

    // The transform that `register` writes is the one that `view` finds.
    succeed(&["register", &second, &sample(), "-o", &json]);
    succeed(&[&["view", &sample(), &second, "-o", &given, "--transform", &json], &options[..]].concat());
    let given = &page_data(&given)["pair"];
    assert_eq!((&given["t_first_second"], &given["links"]), (&pair["t_first_second"], &pair["links"]));
    assert!(given["registration"].is_null() && pair["registration"].is_array());
}

#[test]
fn a_registration_is_shown_with_its_matches() {
    let folder = tempfile::tempdir().unwrap();
    let (page, json, second) = (file(&folder, "r.html"), file(&folder, "t.json"), rotated(&folder));
    let printed = succeed(&["register", &sample(), &second, "--view", &page, "-o", &json]);
    assert!(printed.contains(&page), "{printed}");
    let registration: Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
    let data = page_data(&page);
    // The target comes first, and the scene is in its frame.
    assert_eq!(
        (data["clouds"][0]["name"].as_str(), data["clouds"][1]["name"].as_str()),
        (Some(&*second), Some(&*sample()))
    );
    assert_eq!(data["pair"]["t_first_second"], registration["t_target_source"]);
    assert_eq!(data["pair"]["verdict"]["confidence"], registration["verdict"]["confidence"]);
    let links = data["pair"]["links"].as_array().unwrap();
    assert_eq!(links.len() as u64, registration["matches"]["num_agreeing"].as_u64().unwrap());
    let t: RigidTransform = serde_json::from_value(registration["t_target_source"].clone()).unwrap();
    let end = |cloud: usize, link: &Value| -> Point {
        let keypoint = &data["clouds"][cloud]["keypoints"][link[cloud].as_u64().unwrap() as usize];
        ["x", "y", "z"].map(|axis| keypoint[axis].as_f64().unwrap() as f32)
    };
    for link in links {
        let (a, b) = (end(0, link), transform_points(&t, &[end(1, link)])[0]);
        let distance = (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f32>().sqrt();
        assert!((f64::from(distance) - link[2].as_f64().unwrap()).abs() < 1e-4, "{link}");
        assert!(f64::from(distance) < 1.001 * registration["fit"]["inlier_distance"].as_f64().unwrap());
    }
    let html = std::fs::read_to_string(&page).unwrap();
    assert!(html.starts_with("<!doctype html>") && html.contains(": registration</title>"));
}

#[test]
fn a_page_is_complete_and_identical_for_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (file(&folder, "one.html"), file(&folder, "two.html"));
    succeed(&["view", &sample(), &rotated(&folder), "-o", &one, "--threads", "1"]);
    succeed(&["view", &sample(), &rotated(&folder), "-o", &two, "--threads", "3"]);
    let page = std::fs::read_to_string(&one).unwrap();
    assert_eq!(page, std::fs::read_to_string(&two).unwrap());
    for network in ["http:", "https:", "src=", "@import", "fetch("] {
        assert!(!page.contains(network), "{network}");
    }
    let data = page_data(&one);
    let cloud = &data["clouds"][0];
    assert_eq!((cloud["num_points"].as_u64(), cloud["points"]["count"].as_u64()), (Some(4096), Some(4096)));
    assert!(cloud["surface"]["count"].as_u64().unwrap() > 1000);
    assert_eq!(data["options"]["detect"]["max_keypoints"], 64);
}

/// A tube along a knot, in text.
fn knot(count: usize) -> String {
    let row = |i: usize| {
        let (t, a) = (i as f64 * 0.618_034 % 1.0 * std::f64::consts::TAU, i as f64);
        let r = 2.0 + (3.0 * t).cos() + 0.3 * a.cos();
        format!("{:.4} {:.4} {:.4}\n", r * (2.0 * t).cos(), r * (2.0 * t).sin(), (3.0 * t).sin() + 0.3 * a.sin())
    };
    (0..count).map(row).collect()
}

#[test]
fn pages_stay_small() {
    let folder = tempfile::tempdir().unwrap();
    let (cloud, page) = (file(&folder, "knot.xyz"), file(&folder, "knot.html"));
    let size = |number| {
        std::fs::write(&cloud, knot(number)).unwrap();
        let printed = succeed(&["view", &cloud, "-o", &page]);
        (printed, page_data(&page)["clouds"][0]["points"]["count"].as_u64(), std::fs::metadata(&page).unwrap().len())
    };
    let (_, shown, bytes) = size(100_000);
    assert!(shown == Some(100_000) && bytes < 8_000_000, "{bytes}");
    let (printed, shown, bytes) = size(500_000);
    assert!(printed.contains("(250000 shown)") && shown == Some(250_000) && bytes < 8_000_000, "{printed} {bytes}");
}

/// Chromium, if there is one.
fn chromium() -> Option<PathBuf> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let folders: Vec<PathBuf> = std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()).collect();
    let browser = folders.iter().flat_map(|folder| names.map(|name| folder.join(name))).find(|path| path.is_file());
    if browser.is_none() {
        eprintln!("skipped: no Chromium to open the page in");
    }
    browser
}

/// Opens a page with a script appended; its elements once that ran. The console must stay empty.
fn open(chromium: &Path, folder: &TempDir, page: &str, script: &str, window: &str) -> String {
    let (path, profile) = (file(folder, "opened.html"), file(folder, "profile"));
    let text = std::fs::read_to_string(page).unwrap();
    std::fs::write(&path, text.replace("</body>", &format!("<script>{script}</script></body>"))).unwrap();
    let flags = "--headless=new --no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader \
                 --virtual-time-budget=5000 --enable-logging=stderr --dump-dom";
    let output = Command::new(chromium)
        .args(flags.split_whitespace())
        .args([format!("--window-size={window}"), format!("--user-data-dir={profile}"), format!("file://{path}")])
        .output()
        .unwrap();
    let log = String::from_utf8_lossy(&output.stderr);
    let console: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
    assert!(output.status.success() && console.is_empty(), "{console:#?}");
    String::from_utf8_lossy(&output.stdout).into()
}

/// Switches the surface on, then points at places until there is a keypoint, and counts the colours that are drawn.
const LOOK: &str = r##"
setTimeout(() => {
  document.querySelectorAll("#controls label")[2].click();
  draw();
  const pixels = new Uint8Array(canvas.width * canvas.height * 4);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  document.documentElement.dataset.colors = new Set(new Uint32Array(pixels.buffer)).size;
  for (let y = 0; y < canvas.clientHeight && byId("tooltip").hidden; y += 5) {
    for (let x = 0; x < canvas.clientWidth && byId("tooltip").hidden; x += 5) {
      canvas.dispatchEvent(new PointerEvent("pointermove", { clientX: x, clientY: y }));
    }
  }
}, 500);"##;

/// The number after an attribute's name.
fn attribute(page: &str, name: &str) -> Option<u32> {
    page.split_once(&format!("{name}=\""))?.1.split_once('"')?.0.parse().ok()
}

#[test]
fn outliers_are_named_by_every_command_and_change_no_result() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = io::read_points(sample().as_ref()).unwrap();
    let [clean, dirty] = ["clean.npy", "dirty.npy"].map(|name| file(&folder, name));
    io::write_points(clean.as_ref(), &cloud, [0.0; 3]).unwrap();
    io::write_points(dirty.as_ref(), &[&cloud[..], &[[1e4, 0.0, 0.0]]].concat(), [0.0; 3]).unwrap();
    for (command, output) in [("detect", "json"), ("reconstruct", "ply"), ("field", "npy"), ("view", "html")] {
        let results = [&clean, &dirty].map(|input| {
            let result = format!("{input}.{output}");
            let more: &[&str] = if command == "field" { &["--quantity", "saliency"] } else { &[] };
            let done = snake(&[&[command, input, "-o", &result], more].concat());
            let said = String::from_utf8_lossy(&done.stderr).into_owned();
            assert!(done.status.success(), "{command}: {said}");
            (said, std::fs::read(result).unwrap())
        });
        let [(clean_output, expected), (dirty_output, found)] = results;
        let named = format!("1 of {} points is ", cloud.len() + 1);
        assert!(dirty_output.contains(&named) && !clean_output.contains("left out"), "{command}: {dirty_output}");
        assert!(command == "view" || found == expected, "{command}");
    }
}

/// How many pixels of the points are left without the far side, in per cent.
const FAR_SIDE: &str = r#"
const inked = () => {
  draw();
  const pixels = new Uint8Array(canvas.width * canvas.height * 4);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  const words = new Uint32Array(pixels.buffer);
  return words.reduce((sum, word) => sum + (word !== words[0]), 0);
};
shown.keypoints = false;
const one = inked();
hideFarSide = () => {};
document.documentElement.dataset.ink = Math.round(100 * one / inked());"#;

#[test]
fn pages_open_in_chromium_suit_the_window_and_hide_the_far_side_of_sparse_clouds() {
    const SIZES: &str = r#"
        document.documentElement.dataset.dots = Math.round(100 * dotScale());
        document.documentElement.dataset.bottom = Math.ceil(byId("facts").getBoundingClientRect().bottom);"#;
    let Some(chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let [sparse, one, two] = ["sparse.npy", "one.html", "two.html"].map(|name| file(&folder, name));
    let points: Vec<_> = io::read_points(sample().as_ref()).unwrap().into_iter().step_by(8).collect();
    io::write_points(sparse.as_ref(), &points, [0.0; 3]).unwrap();
    succeed(&["view", &sparse, "-o", &one]);
    let ink = attribute(&open(&chromium, &folder, &one, FAR_SIDE, "1280,800"), "data-ink").unwrap();
    assert!((10..85).contains(&ink), "{ink} % of the points' pixels are left");
    succeed(&["view", &sample(), "-o", &one]);
    succeed(&["view", &sample(), &rotated(&folder), "-o", &two, "--nms-radius", "0.05"]);
    for (window, dots, height) in [("1280,800", 100..=100, 800), ("390,844", 0..=59, u32::MAX)] {
        let seen = open(&chromium, &folder, &two, SIZES, window);
        let [found, bottom] = ["data-dots", "data-bottom"].map(|name| attribute(&seen, name).unwrap());
        assert!(dots.contains(&found) && bottom <= height, "{window}: {found} {bottom}");
    }
    for (page, words) in [
        (&one, ["triangles", "keypoint, larger with its confidence"]),
        (&two, ["repeat in B within", "keypoint of one cloud only"]),
    ] {
        let seen = open(&chromium, &folder, page, LOOK, "960,580");
        assert!(seen.contains("data-state=\"drawn\""), "the scene was not drawn");
        assert!(attribute(&seen, "data-colors").unwrap() > 500, "{:?}", attribute(&seen, "data-colors"));
        let (_, tooltip) = seen.split_once("id=\"tooltip\"").unwrap();
        let is_named = ["score (saliency)", "confidence"].iter().all(|name| tooltip[..400].contains(name));
        assert!(is_named && words.iter().all(|word| seen.contains(word)), "{}", &tooltip[..400]);
    }
}

#[test]
fn the_panel_fits_and_a_camera_looks_along_z_with_y_down() {
    type Place = fn([f64; 3]) -> [f64; 3];
    const LOOK: &str = r#"
        document.documentElement.dataset.bottom = Math.ceil(byId("facts").getBoundingClientRect().bottom);
        document.documentElement.dataset.up = (view.down ? "-" : "+") + "xyz"[view.up];"#;
    let Some(chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let (cloud, page) = (file(&folder, "cloud.xyz"), file(&folder, "cloud.html"));
    // The knot is 7 wide and 2.6 high. A standing one is as high as it is wide, and begins at the ground.
    let knot: Vec<[f64; 3]> =
        knot(4000).lines().map(|line| [0, 1, 2].map(|i| line.split(' ').nth(i).unwrap().parse().unwrap())).collect();
    let cases: [(Place, &str); 3] = [
        (|[x, y, z]| [x, z, y], "+y"),
        (|[x, y, z]| [x, y, 2.0 * z + 8.0], "-y"),
        (|[x, y, z]| [x / 4.0, y / 4.0, z + 1.3], "+z"),
    ];
    for (place, up) in cases {
        let rows = knot.iter().map(|p| place(*p).map(|v| format!("{v:.4}")).join(" ") + "\n");
        std::fs::write(&cloud, rows.collect::<String>()).unwrap();
        succeed(&["view", &cloud, "-o", &page]);
        let seen = open(&chromium, &folder, &page, LOOK, "960,580");
        assert!(seen.contains(&format!("data-up=\"{up}\"")), "{up}: {seen:.300}");
        // The window's own bars take some of its 580 pixels; a page has them all.
        assert!(attribute(&seen, "data-bottom").unwrap() <= 580, "{seen:.300}");
        assert!(seen.contains("Keypoints · compact"), "the page says the model");
    }
}

#[cfg(unix)]
#[test]
fn file_names_cannot_become_markup_and_a_page_without_webgl_shows_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let (page, parent) = (file(&folder, "page.html"), folder.path().join("a<"));
    std::fs::create_dir(&parent).unwrap();
    let cloud = parent.join("script><img src=x onerror=console.error(1)>&\"'{SCRIPT}.ply");
    std::fs::copy(sample(), &cloud).unwrap();
    succeed(&["view", cloud.to_str().unwrap(), "-o", &page]);
    let text = std::fs::read_to_string(&page).unwrap();
    assert!(!text.contains("<img"));
    assert_eq!(page_data(&page)["clouds"][0]["name"], cloud.to_str().unwrap());
    let Some(chromium) = chromium() else { return };
    let seen = open(&chromium, &folder, &page, "", "960,580");
    assert!(seen.contains("data-state=\"drawn\"") && !seen.contains("<img"));
    let without = text.replace("<body>", "<body><script>HTMLCanvasElement.prototype.getContext = () => null</script>");
    std::fs::write(&page, without).unwrap();
    let seen = open(&chromium, &folder, &page, "", "960,580");
    assert!(seen.contains("data-state=\"failed\"") && seen.contains("This browser has no WebGL 2"));
    assert!(seen.contains("262 144"), "the counts are there");
}

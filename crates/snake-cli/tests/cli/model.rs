//! `snake-cli model` and models by name.

use assert_cmd::Command;

use super::{root, snake, stderr};

#[test]
fn the_model_command_shows_shape_and_metadata() {
    let output = snake(&["model"]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("343874 parameters") && text.contains("32 x 32 x 32") && text.contains("digest"), "{text}");
}

#[test]
fn models_are_found_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let named = |name: &str| {
        let mut command = Command::cargo_bin("snake-cli").unwrap();
        command.args(["model", name]).env("SNAKE_MODELS", folder.path()).output().unwrap()
    };
    let missing = named("mine");
    assert_eq!(missing.status.code(), Some(2));
    let place = folder.path().display().to_string();
    assert!(stderr(&missing).contains("no model `mine`") && stderr(&missing).contains(&place), "{}", stderr(&missing));
    std::fs::copy(root().join("tests/golden/tiny/weights.safetensors"), folder.path().join("mine.safetensors"))
        .unwrap();
    let mine = named("mine");
    assert!(String::from_utf8_lossy(&mine.stdout).contains("volume: 16 x 16 x 16 voxels"), "{}", stderr(&mine));
    // The built-in models have names too, and a path is no name.
    assert_eq!(named("compact").stdout, snake(&["model"]).stdout);
    assert!(String::from_utf8_lossy(&named("scenes").stdout).starts_with("scenes, built-in: 343266 parameters"));
    let path = named("nowhere/mine");
    assert!(stderr(&path).contains("cannot load the model nowhere/mine"), "{}", stderr(&path));
}

//! Use of the command line: help, completions, verbosity, environment, patterns, units, progress, Ctrl-C.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use assert_cmd::cargo::CommandCargoExt;
use serde_json::Value;

use super::{assert_refused, json_lines, root, sample, stderr};

/// snake-cli with an environment of its own.
fn command(arguments: &[&str], environment: &[(&str, &str)]) -> Command {
    let mut command = Command::cargo_bin("snake-cli").unwrap();
    for name in ["SNAKE_MODEL", "SNAKE_MODELS", "SNAKE_THREADS", "SNAKE_SIMD", "NO_COLOR", "CLICOLOR_FORCE"] {
        command.env_remove(name);
    }
    command.args(arguments).envs(environment.iter().copied());
    command
}

pub fn snake_with(arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    command(arguments, environment).output().unwrap()
}

pub fn snake(arguments: &[&str]) -> Output {
    snake_with(arguments, &[])
}

pub fn stdout(output: &Output) -> String {
    assert!(output.status.success(), "{}", stderr(output));
    String::from_utf8_lossy(&output.stdout).into()
}

/// Keypoints of the one line of JSON.
pub fn keypoints(output: &Output) -> Value {
    let report: Value = serde_json::from_str(&stdout(output)).unwrap();
    report["keypoints"].clone()
}

/// The help of a sub-command and of all below it, with their names.
pub fn helps(name: &[&str]) -> Vec<(String, String)> {
    let help = stdout(&snake(&[name, &["--help"]].concat()));
    let (_, commands) = help.split_once("\nCommands:\n").unwrap_or_default();
    let entries = commands.lines().take_while(|line| !line.is_empty());
    // A line that is indented further continues the line before.
    let names = entries.filter(|line| !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next());
    let below: Vec<_> =
        names.filter(|below| *below != "help").flat_map(|below| helps(&[name, &[below]].concat())).collect();
    [vec![(name.join(" "), help.clone())], below].concat()
}

#[test]
fn every_sub_command_shows_examples() {
    let helps = helps(&[]);
    let (_, top) = &helps[0];
    for expected in ["Start here:", "SNAKE_MODEL", "SNAKE_THREADS", "SNAKE_SIMD", "NO_COLOR", "--quiet", "--verbose"] {
        assert!(top.contains(expected), "{expected}: {top}");
    }
    let names: Vec<&str> = helps.iter().map(|(name, _)| name.as_str()).collect();
    for name in ["detect", "register", "model", "completions"] {
        assert!(names.contains(&name), "{names:?}");
    }
    for (name, help) in &helps {
        // The ends of the tree: what only leads on to others has none of its own.
        if !help.contains("\nCommands:\n") {
            assert!(help.contains("Examples:\n") && help.contains(&format!("snake-cli {name}")), "{name}: {help}");
            assert!(help.contains("--quiet"), "{name}: {help}");
        }
        assert!(help.lines().all(|line| line.trim_end().chars().count() <= 120), "{name}");
    }
}

#[cfg(unix)]
#[test]
fn bash_completes_sub_commands_and_their_options() {
    let folder = tempfile::tempdir().unwrap();
    let script = folder.path().join("snake-cli.bash");
    std::fs::write(&script, stdout(&snake(&["completions", "bash"]))).unwrap();
    // Bash completes the last word like this: the function of `complete` is called with the program and two words.
    let typed = "source $0; read -ra words <<< $(complete -p snake-cli); COMP_WORDS=($@); COMP_CWORD=$(($# - 1))
        ${words[${#words[@]} - 2]} $1 \"${@: -1}\" \"${@: -2:1}\"; echo ${COMPREPLY[@]}";
    let completed = |line: &str| {
        let output = Command::new("bash").args(["-c", typed]).arg(&script).args(line.split(' ')).output().unwrap();
        stdout(&output).trim().to_owned()
    };
    assert_eq!(completed("snake-cli regi"), "register");
    assert_eq!(completed("snake-cli detect --nms"), "--nms-radius");
    assert_eq!(completed("snake-cli completions ba"), "bash");
    // Every option of every sub-command, as its help lists them.
    for (name, help) in helps(&[]) {
        let offered = completed(&format!("snake-cli {name} --").replace("  ", " "));
        let offered: Vec<&str> = offered.split(' ').collect();
        // Descriptions are indented further than options.
        for line in help.lines().filter(|line| line.starts_with("  -") || line.starts_with("      --")) {
            let option = line.split_whitespace().find(|word| word.starts_with("--")).unwrap();
            assert!(offered.contains(&option), "{name}: {option}: {offered:?}");
        }
    }
}

#[test]
fn quiet_leaves_files_json_and_errors() {
    let folder = tempfile::tempdir().unwrap();
    let result = folder.path().join("k.csv").display().to_string();
    let output = snake(&["detect", &sample(), "-q", "-o", &result]);
    assert_eq!((stdout(&output), stderr(&output)), (String::new(), String::new()));
    assert!(std::fs::read_to_string(&result).unwrap().starts_with("x,y,z"));
    assert!(!keypoints(&snake(&["--quiet", "detect", &sample(), "--json"])).as_array().unwrap().is_empty());
    let output = snake(&["register", &sample(), &sample(), "-q", "--set", "max_keypoints=100"]);
    assert_eq!(stdout(&output), "");
    let output = snake(&["detect", "nowhere.ply", "--quiet"]);
    assert_eq!(output.status.code(), Some(2));
    let said = stderr(&output);
    assert!(said.starts_with("error: nowhere.ply: ") && said.lines().count() == 1, "{said}");
    // The words of the system, once.
    assert_eq!(said.matches("(os error 2)").count(), 1, "{said}");
    assert_eq!(snake(&["detect", &sample(), "-q", "-v"]).status.code(), Some(2));
}

#[test]
fn verbose_reports_settings_and_changes_no_result() {
    let plain = snake(&["detect", &sample(), "--json"]);
    let verbose = snake(&["detect", &sample(), "--json", "-v", "--threads", "3", "--nms-radius", "4r"]);
    assert_eq!(stderr(&plain), "");
    let said = stderr(&verbose);
    let simd = snake_core::SimdLevel::current().name();
    for expected in [
        &format!("threads: 3, SIMD {simd}\n"),
        "model: compact, built-in, ",
        "\"nms_radius\":\"4r\"",
        "queries: 262144, ",
        "seconds: read 0.",
        "total ",
    ] {
        assert!(said.contains(expected), "{expected}: {said}");
    }
    assert_eq!(keypoints(&verbose), keypoints(&snake(&["detect", &sample(), "--json", "--nms-radius", "4r"])));
    let said = stderr(&snake(&["-v", "register", &sample(), &sample(), "--set", "max_keypoints=100"]));
    assert!(said.contains("points: 4096 and 4096") && said.contains("\"voxel_size\":null"), "{said}");
}

#[test]
fn options_can_be_environment_variables() {
    let golden = root().join("tests/golden/tiny/weights.safetensors").display().to_string();
    let weights: &[(&str, &str)] = &[("SNAKE_MODEL", &golden)];
    let builtin = stdout(&snake(&["model"]));
    assert_ne!(stdout(&snake_with(&["model"], weights)), builtin);
    assert_eq!(stdout(&snake_with(&["model"], weights)), stdout(&snake(&["model", &golden])));
    let nowhere: &[(&str, &str)] = &[("SNAKE_MODEL", "nowhere.safetensors")];
    for arguments in [&["detect", &sample()][..], &["register", &sample(), &sample()]] {
        let output = snake_with(arguments, nowhere);
        assert!(stderr(&output).contains("nowhere.safetensors"), "{}", stderr(&output));
    }
    // A given option wins.
    assert!(snake_with(&["detect", &sample(), "--model", &golden], nowhere).status.success());
    let said = stderr(&snake_with(&["detect", &sample(), "-v"], &[("SNAKE_THREADS", "3")]));
    assert!(said.contains("threads: 3,"), "{said}");
    let output = snake_with(&["detect", &sample()], &[("SNAKE_THREADS", "many")]);
    assert!(output.status.code() == Some(2) && stderr(&output).contains("--threads"), "{}", stderr(&output));
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("snake.toml"), "threads = 1").unwrap();
    let output = command(&["detect", &sample()], &[]).current_dir(folder.path()).output().unwrap();
    assert_refused(&output, "snake.toml: no such file is read");
    let sse: &[(&str, &str)] = &[("SNAKE_SIMD", "sse")];
    let output = snake_with(&["detect", &sample()], sse);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).starts_with("error: SNAKE_SIMD is sse: allowed is portable"), "{}", stderr(&output));
    let empty = ["SNAKE_THREADS", "SNAKE_MODEL", "SNAKE_SIMD"].map(|name| (name, ""));
    assert_eq!(stderr(&snake_with(&["detect", &sample()], &empty)), "");
    assert_eq!(stderr(&snake_with(&["detect", &sample()], &[("SNAKE_SIMD", "portable")])), "");
}

#[test]
fn colours_are_for_terminals() {
    let detect = ["detect", &sample(), "nowhere.ply"];
    let all = |environment: &[(&str, &str)]| {
        let output = snake_with(&detect, environment);
        [output.stdout, output.stderr].map(|text| text.contains(&0x1b))
    };
    assert_eq!(all(&[]), [false, false]);
    assert_eq!(all(&[("NO_COLOR", "1")]), [false, false]);
    assert_eq!(all(&[("CLICOLOR_FORCE", "1")]), [true, true]);
}

/// The output of a command on a pseudo-terminal up to `expected`; it is ended then. `None` where there is no `script`.
#[cfg(target_os = "linux")]
pub fn shown_on_terminal(command: &str, folder: &Path, expected: &str) -> Option<String> {
    use std::io::Read;
    if Command::new("script").arg("--version").output().is_err() {
        eprintln!("skipped: without `script` there is no terminal to look at");
        return None;
    }
    let command = format!("exec '{}' {command}", env!("CARGO_BIN_EXE_snake-cli"));
    let mut script = Command::new("script");
    // Without a kind of terminal there are no bars.
    script.current_dir(folder).env("TERM", "xterm").args(["-qefc", &command, "/dev/null"]).stdin(Stdio::null());
    let mut child = Running(script.stdout(Stdio::piped()).spawn().unwrap());
    let (mut shown, mut bytes) = (String::new(), [0; 4096]);
    while !shown.contains(expected) {
        let length = child.0.stdout.as_mut().unwrap().read(&mut bytes).unwrap();
        assert!(length > 0, "{command}: ended by itself: {shown:?}");
        shown += &String::from_utf8_lossy(&bytes[..length]);
    }
    // Without its terminal the call would continue where hang-ups are ignored, as under `nohup`.
    Command::new("pkill").args(["-KILL", "-P", &child.0.id().to_string()]).status().ok();
    Some(shown)
}

/// A program that is killed when the test is done with it, however the test ends.
struct Running(std::process::Child);

impl Drop for Running {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

/// Long work and no terminal: a line every ten seconds shows the progress.
#[cfg(unix)]
#[test]
fn long_work_has_lines_without_a_terminal() {
    use std::io::{BufRead, BufReader};
    let options = ["query_resolution=128", "occupancy_threshold=0", "query_band=0", "refine_steps=100"];
    let options = options.into_iter().flat_map(|option| ["--set", option]);
    let mut command = Command::new(env!("CARGO_BIN_EXE_snake-cli"));
    command.arg("detect").arg(sample()).args(options).args(["--threads", "1"]);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    let start = std::time::Instant::now();
    let mut child = Running(command.spawn().unwrap());
    // The clock goes on while the program is stopped.
    for (signal, seconds) in [("-STOP", 9), ("-CONT", 0)] {
        std::thread::sleep(std::time::Duration::from_millis(500));
        assert!(Command::new("kill").args([signal, &child.0.id().to_string()]).status().unwrap().success());
        std::thread::sleep(std::time::Duration::from_secs(seconds));
    }
    let mut lines = BufReader::new(child.0.stderr.take().unwrap()).lines().map(Result::unwrap);
    let counted = lines.find(|line| line.contains(" of ")).unwrap();
    assert!(counted.contains(": refinement, ") && counted.ends_with(" left"), "{counted}");
    assert!(start.elapsed().as_secs() >= 10);
}

#[cfg(target_os = "linux")]
#[test]
fn an_interrupt_leaves_only_complete_files() {
    const INPUTS: usize = 400;
    let folder = tempfile::tempdir().unwrap();
    let (clouds, results) = (folder.path().join("clouds"), folder.path().join("results"));
    std::fs::create_dir(&clouds).unwrap();
    for index in 0..INPUTS {
        std::fs::copy(sample(), clouds.join(format!("{index:03}.ply"))).unwrap();
    }
    let written = || results.read_dir().map_or(0, Iterator::count);
    let arguments = ["detect", clouds.to_str().unwrap(), "-o", results.to_str().unwrap(), "--json"];
    // Where the tests themselves run in the background, Ctrl-C may be ignored, and would be here.
    let mut command = Command::new("env");
    command.args(["--default-signal=INT", env!("CARGO_BIN_EXE_snake-cli")]).args(arguments);
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    while written() < 5 {
        assert!(child.try_wait().unwrap().is_none(), "ended by itself");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(written() < INPUTS);
    for entry in results.read_dir().unwrap() {
        let path = entry.unwrap().path();
        assert!(path.display().to_string().ends_with(".keypoints.ply"), "{}", path.display());
        assert!(!snake_io::read_points(&path).unwrap().is_empty(), "{}", path.display());
    }
}

#[test]
fn the_schema_has_the_keys_of_the_report() {
    let schema: Value = serde_json::from_str(&stdout(&snake(&["schema"]))).unwrap();
    let drive = root().join("tests/data/io/drive.mcap").display().to_string();
    let report = &json_lines(&snake(&["detect", &drive, "--json"]))[0];
    let keys = |value: &Value| -> Vec<String> { value.as_object().unwrap().keys().cloned().collect() };
    let [counts, times] = ["counts", "timing_seconds"].map(|part| &schema["properties"][part]["properties"]);
    let normalization = &schema["properties"]["normalization"]["anyOf"][1]["properties"];
    let keypoint = &schema["properties"]["keypoints"]["items"]["properties"];
    for (described, found) in [
        (&schema["properties"], report),
        (&schema["properties"]["recorded"]["properties"], &report["recorded"]),
        (counts, &report["counts"]),
        (times, &report["timing_seconds"]),
        (normalization, &report["normalization"]),
        (keypoint, &report["keypoints"][0]),
    ] {
        assert_eq!(keys(described), keys(found));
    }
    let report = &json_lines(&snake(&["detect", &sample(), "--json"]))[0];
    assert!(schema["required"].as_array().unwrap().iter().all(|key| report.get(key.as_str().unwrap()).is_some()));
    assert!(report.get("recorded").is_none());
}

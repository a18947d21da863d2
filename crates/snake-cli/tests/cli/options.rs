//! Options: each is a row of a table of the core, and every interface follows from it.

use snake_core::{DetectOptions, EncodeOptions, OptionGroup, OptionInfo};
use snake_registration::{AlignOptions, PairOptions, RegisterOptions};

use super::usage::{helps, keypoints, snake, stdout};
use super::{sample, stderr};

/// The options of detection, and of registration of a pair and of many clouds.
fn tables() -> [(&'static str, Vec<&'static OptionInfo>); 3] {
    let detection = EncodeOptions::OPTIONS.iter().chain(DetectOptions::OPTIONS).collect();
    let registration = |more: &'static [OptionInfo]| RegisterOptions::OPTIONS.iter().chain(more).collect();
    [
        ("detect", detection),
        ("register", registration(PairOptions::OPTIONS)),
        ("align", registration(AlignOptions::OPTIONS)),
    ]
}

#[test]
fn every_option_of_a_table_is_known_everywhere() {
    let listed = stdout(&snake(&["options"]));
    for (command, options) in tables() {
        let help = stdout(&snake(&[command, "--help"])).split_whitespace().collect::<Vec<_>>().join(" ");
        for option in options {
            let name = option.name;
            assert!(listed.lines().any(|line| line.split_whitespace().next() == Some(name)), "{name}: {listed}");
            let flag = format!(" --{} ", name.replace('_', "-"));
            // `register --initial` is a file, the option a matrix.
            if name != "initial" {
                assert_eq!(help.contains(&flag), !option.flag.is_empty(), "{command}{flag}");
            }
            assert!(option.flag.is_empty() || help.contains(&option.help()), "{command}{flag}: {help}");
            if option.flag.is_empty() && name != "initial" {
                let said = stderr(&snake(&[command, &sample(), &sample(), flag.trim(), "1"]));
                assert!(said.contains(&format!("type --set {name}=VALUE")), "{said}");
            }
            // A value of the wrong type is refused by name, so the name is known.
            let given = [command, &sample(), &sample(), "--set", &format!("{name}={{}}")].map(str::to_owned);
            let said = stderr(&snake(&given.each_ref().map(String::as_str)));
            assert!(said.contains(&format!("option `{name}` is {{}}")), "{said}");
        }
    }
}

#[test]
fn general_options_stand_below_the_general_heading() {
    for (name, help) in helps(&[]) {
        let mut heading = "";
        for line in help.lines() {
            if line.ends_with(':') && !line.starts_with(' ') {
                heading = line;
            }
            let option = line.split_whitespace().find(|word| word.starts_with("--")).unwrap_or_default();
            let is_listed = line.starts_with("      --") || line.starts_with("  -");
            if is_listed && ["--model", "--threads", "--output", "--json", "--limit", "--seed"].contains(&option) {
                assert_eq!(heading, "Options:", "{name} {option}");
            }
        }
    }
}

#[test]
fn zero_turns_an_option_off_by_flag_and_by_name() {
    let sample = sample();
    let detect = |arguments: &[&str]| {
        let arguments = [&["detect", &sample, "--json", "--model", "compact"], arguments].concat();
        keypoints(&snake(&arguments))
    };
    for name in ["min_confidence", "nms_radius", "voxel_size"] {
        let (flag, zero) = (format!("--{}", name.replace('_', "-")), format!("{name}=0"));
        assert_eq!(detect(&[&flag, "0"]), detect(&["--set", &zero]), "{name}");
    }
}

#[test]
fn an_old_flag_names_the_option_and_the_help_is_short() {
    let listed = stdout(&snake(&["options"]));
    let line = |name: &str| listed.lines().find(|line| line.starts_with(name)).unwrap().split_whitespace().skip(1);
    assert_eq!(line("nms_radius").take(2).collect::<Vec<_>>(), ["10%", "6.5v"]);
    let old = [("--refine-steps", "refine_steps"), ("--icp-steps", "icp_steps"), ("--hypotheses=3", "hypotheses")];
    for (flag, name) in old {
        let said = stderr(&snake(&["detect", &sample(), flag, "3"]));
        assert!(said.contains(&format!("type --set {name}=VALUE")), "{said}");
    }
    let options = |command: &str| {
        stdout(&snake(&[command, "--help"]))
            .lines()
            .filter(|line| {
                line.trim_start().starts_with("--") || line.trim_start().starts_with("-") && line.contains(", --")
            })
            .count()
    };
    assert!(options("detect") <= 27 && options("register") <= 20, "{} {}", options("detect"), options("register"));
}

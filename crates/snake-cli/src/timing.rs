//! Seconds of each stage of a detection, for the JSON report and `--timing`.

use crate::terminal::Report;

/// The stages of one cloud, in order; the total includes writing the output.
pub const STAGES: [&str; 6] = ["read", "encode", "occupancy", "refine", "nms", "total"];

/// The seconds of each stage in [`STAGES`].
pub type Seconds = [f64; STAGES.len()];

/// The seconds of one cloud on one line.
pub fn line(seconds: &Seconds) -> String {
    let stage = |(stage, seconds): (&str, &f64)| format!("{stage} {seconds:.3}");
    STAGES.into_iter().zip(seconds).map(stage).collect::<Vec<_>>().join(", ")
}

/// A table with one line per stage: the seconds of a single cloud, or the median, maximum and sum over several clouds.
/// There is at least one cloud.
pub fn summary(load_model: f64, clouds: &[Seconds]) -> Report {
    let columns: &[&str] = if clouds.len() == 1 { &["seconds"] } else { &["median", "maximum", "sum"] };
    let line = |stage: &str, cells: &[String]| {
        let cells: String = cells.iter().map(|cell| format!("{cell:>10}")).collect();
        format!("{stage:<10}{cells}")
    };
    let mut report = Report::default();
    if clouds.len() > 1 {
        report.line(format!("seconds over {} clouds", clouds.len()));
    }
    report.line(line("stage", &columns.iter().map(|&name| name.into()).collect::<Vec<_>>()));
    report.line(line("load model", &[format!("{load_model:.4}")]));
    for (index, stage) in STAGES.iter().enumerate() {
        let mut seconds: Vec<f64> = clouds.iter().map(|cloud| cloud[index]).collect();
        seconds.sort_by(f64::total_cmp);
        let last = seconds.len() - 1;
        let median = (seconds[last / 2] + seconds[last.div_ceil(2)]) / 2.0;
        let values = [median, seconds[last], seconds.iter().sum()];
        let cells: Vec<String> = values[..columns.len()].iter().map(|value| format!("{value:.4}")).collect();
        report.line(line(stage, &cells));
    }
    report
}

//! Curves as SVG, in the style of the paper's figure 5: one line for each method, with panels side by side.

use std::fmt::Write;

use super::Chart;

/// The curve of a method in one diagram.
struct Curve<'a> {
    method: &'a str,
    /// Whether the figures are the paper's. The line is then dashed, in the colour of our method of the same name.
    is_paper: bool,
    /// One value for each tick; `None` where there is no figure.
    values: Vec<Option<f64>>,
}

/// A diagram with values from 0 to 1.
struct Panel<'a> {
    x_label: &'a str,
    /// The x coordinates of the values, with their labels.
    ticks: Vec<(f64, String)>,
    curves: Vec<Curve<'a>>,
}

impl<'a> Panel<'a> {
    /// The diagram of a chart; `None` for a table alone.
    fn new(chart: &'a Chart) -> Option<Self> {
        let x_label = chart.axis.label.as_deref()?;
        let values = &chart.axis.values;
        let ours = chart.series.iter().map(|s| Curve { method: &s.method, is_paper: false, values: s.curve.clone() });
        let theirs = chart.paper.into_iter().flat_map(|paper| paper.at(values));
        let theirs = theirs.map(|(method, values)| Curve { method, is_paper: true, values });
        let ticks = values.iter().map(|&value| ((chart.axis.x)(value), value.to_string())).collect();
        Some(Self { x_label, ticks, curves: ours.chain(theirs).collect() })
    }
}

// Size of a diagram and of its margins, in pixels.
const WIDTH: f64 = 300.0;
const HEIGHT: f64 = 220.0;
const LEFT: f64 = 48.0;
const TOP: f64 = 16.0;
const BOTTOM: f64 = 48.0;
/// Width and height of an entry of the legend, in pixels.
const ENTRY: [f64; 2] = [120.0, 16.0];
/// Colours that colour-blind readers can distinguish (Okabe and Ito).
const COLORS: [&str; 9] =
    ["#d55e00", "#0072b2", "#009e73", "#e69f00", "#cc79a7", "#56b4e9", "#000000", "#999999", "#f0e442"];

/// Draws the charts side by side with one legend below: a whole SVG file. `None` if all of them are tables alone.
pub fn svg(y_label: &str, charts: &[Chart]) -> Option<String> {
    let panels: Vec<Panel> = charts.iter().filter_map(Panel::new).collect();
    let mut methods: Vec<&str> = Vec::new();
    let mut entries: Vec<(&str, bool)> = Vec::new();
    for &Curve { method, is_paper, .. } in panels.iter().flat_map(|panel| &panel.curves) {
        if !methods.contains(&method) {
            methods.push(method);
        }
        if !entries.contains(&(method, is_paper)) {
            entries.push((method, is_paper));
        }
    }
    let color = |method: &str| {
        let index = methods.iter().position(|known| *known == method).unwrap_or(0);
        COLORS[index % COLORS.len()]
    };
    let width = panels.len() as f64 * (LEFT + WIDTH) + LEFT;
    let columns = (((width - LEFT) / ENTRY[0]) as usize).max(1);
    let height = TOP + HEIGHT + BOTTOM + entries.len().div_ceil(columns) as f64 * ENTRY[1];
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" font-family=\"sans-serif\" \
         font-size=\"11\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n"
    );
    for (i, panel) in panels.iter().enumerate() {
        let left = LEFT + i as f64 * (LEFT + WIDTH);
        text += &format!("<g transform=\"translate({left} {TOP})\">\n{}", axes(panel, y_label));
        for Curve { method, values, is_paper } in &panel.curves {
            let points = panel.ticks.iter().zip(values).filter_map(|((x, _), y)| Some((across(panel, *x), up((*y)?))));
            let mut points: Vec<(f64, f64)> = points.collect();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            text += &curve(&points, color(method), *is_paper);
        }
        text += "</g>\n";
    }
    for (i, &(method, is_paper)) in entries.iter().enumerate() {
        let (column, row) = (i % columns, i / columns);
        let (x, y) = (LEFT + column as f64 * ENTRY[0], TOP + HEIGHT + BOTTOM + row as f64 * ENTRY[1]);
        text += &curve(&[(x, y), (x + 22.0, y)], color(method), is_paper);
        let mark = if is_paper { " (paper)" } else { "" };
        writeln!(text, "<text x=\"{}\" y=\"{}\">{method}{mark}</text>", x + 28.0, y + 4.0).unwrap_or_default();
    }
    (!panels.is_empty()).then(|| text + "</svg>\n")
}

/// Draws the frame, grid, ticks and labels.
fn axes(panel: &Panel, y_label: &str) -> String {
    let mut text = String::new();
    for fifth in 0..=5 {
        let share = f64::from(fifth) / 5.0;
        let y = up(share);
        text += &format!("<path d=\"M0 {y}H{WIDTH}\" stroke=\"#ddd\"/>\n");
        text += &format!("<text x=\"-6\" y=\"{}\" text-anchor=\"end\">{share}</text>\n", y + 4.0);
    }
    for (x, label) in &panel.ticks {
        let (x, y) = (across(panel, *x), HEIGHT + 14.0);
        text += &format!("<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{label}</text>\n");
    }
    let (middle, below) = (WIDTH / 2.0, HEIGHT + 30.0);
    text += &format!("<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"none\" stroke=\"#444\"/>\n");
    text += &format!("<text x=\"{middle}\" y=\"{below}\" text-anchor=\"middle\">{}</text>\n", panel.x_label);
    let (x, y) = (-HEIGHT / 2.0, -32.0);
    text + &format!("<text transform=\"rotate(-90)\" x=\"{x}\" y=\"{y}\" text-anchor=\"middle\">{y_label}</text>\n")
}

/// Draws a line through points, with a dot on each point. An empty list draws nothing.
fn curve(points: &[(f64, f64)], color: &str, dashed: bool) -> String {
    let through: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let dashes = if dashed { " stroke-dasharray=\"5 3\"" } else { "" };
    let mut text = format!(
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"1.5\"{dashes}/>\n",
        through.join(" ")
    );
    for (x, y) in points {
        writeln!(text, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.5\" fill=\"{color}\"/>").unwrap_or_default();
    }
    text
}

/// Pixels from the left edge of the diagram. The outer ticks lie a little inside it, and a single tick in the middle.
fn across(panel: &Panel, x: f64) -> f64 {
    let fold_ticks = |choose: fn(f64, f64) -> f64, start| panel.ticks.iter().map(|(x, _)| *x).fold(start, choose);
    let (least, most) = (fold_ticks(f64::min, f64::INFINITY), fold_ticks(f64::max, f64::NEG_INFINITY));
    let share = if most > least { (x - least) / (most - least) } else { 0.5 };
    WIDTH * (0.05 + 0.9 * share)
}

/// Pixels from the top edge of the diagram.
fn up(share: f64) -> f64 {
    HEIGHT * (1.0 - share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::paper::PaperTable;
    use crate::tables::{Axis, Series};

    #[test]
    fn lines_go_through_the_figures_in_the_order_of_x() {
        const PAPER: PaperTable = PaperTable { column_values: &[2.0], rows: &[("iss", &[0.25])] };
        let chart = |label: &str, values: &[f64], series: &[(&str, &[Option<f64>])], paper| {
            let axis = Axis { label: Some(label.into()), prefix: "", values: values.into(), x: |x| x };
            let method = |&(method, curve): &(&str, &[Option<f64>])| Series {
                title: String::new(),
                method: method.into(),
                cells: Vec::new(),
                curve: curve.into(),
            };
            let series = series.iter().map(method).collect();
            Chart { title: String::new(), first: "method", axis, others: &[], series, paper }
        };
        let ours = chart("ε", &[4.0, 2.0, 3.0], &[("iss", &[Some(1.0), Some(0.0), Some(0.5)])], Some(&PAPER));
        let alone = chart("σ", &[7.0], &[("iss", &[Some(0.5)])], None);
        let text = svg("share", &[ours, alone]).unwrap();
        // 0.05, 0.5 and 0.95 of 300 across, and from 220 to 0 up.
        assert!(
            text.contains("points=\"15.0,220.0 150.0,110.0 285.0,0.0\" fill=\"none\" stroke=\"#d55e00\""),
            "{text}"
        );
        assert!(
            text.contains("points=\"15.0,165.0\" fill=\"none\" stroke=\"#d55e00\" stroke-width=\"1.5\" stroke-dash")
        );
        assert!(text.contains("points=\"150.0,110.0\""), "{text}");
        // Three lines and two of the legend.
        assert_eq!(text.matches("<polyline").count(), 5);
        assert_eq!((text.matches(">iss</text>").count(), text.matches(">iss (paper)</text>").count()), (1, 1));
        for label in ["4", "2", "3", "7", "ε", "σ", "share"] {
            assert!(text.contains(&format!(">{label}</text>")), "{label}");
        }
        // Two columns fit below one panel: seven names take four rows of 16.
        let names = ["a", "b", "c", "d", "e", "f", "g"].map(|name| (name, &[Some(0.5)][..]));
        let legend = svg("share", &[chart("ε", &[7.0], &names, None)]).unwrap();
        assert!(
            legend.contains("width=\"396\" height=\"348\"") && legend.contains("<text x=\"76\" y=\"336\">g"),
            "{legend}"
        );
        assert_eq!(text.matches("<g ").count(), text.matches("</g>").count());
    }
}

//! Images of values with axes and a colour bar, in rows and columns.

use noto_sans_mono_bitmap::FontWeight::{Bold, Regular};

use super::canvas::{Canvas, Color, Direction, TEXT_HEIGHT, TEXT_WIDTH};
use super::colormap::Colormap;

/// An image of values over a rectangle.
pub struct Panel {
    pub title: String,
    /// Values in rows of `columns` each, from the low end of the vertical axis. The first and the last row and column
    /// lie on the ends of the axes.
    pub values: Vec<f32>,
    pub columns: usize,
    /// Horizontal and vertical.
    pub axes: [PanelAxis; 2],
    /// Horizontal and vertical coordinates of the dots over the image.
    pub points: Vec<[f64; 2]>,
}

/// One axis of a panel.
pub struct PanelAxis {
    pub label: &'static str,
    pub low: f64,
    pub high: f64,
}

/// Length of the longer side of an image, in pixels.
const SIDE: f32 = 440.0;
/// Margins of an image, in pixels: left, top, right, bottom.
const MARGIN: [i32; 4] = [92, 36, 20, 56];
/// Width of a colour bar and of the numbers to its right, in pixels.
const BAR: i32 = 16;
const BAR_NUMBERS: i32 = 64;
const FRAME: Color = [38, 38, 44];
/// The most dots on an image, because more would hide it. Beyond this number every n-th point is drawn.
const MAX_DOTS: usize = 6000;

/// Rows of panels, one colour bar for each row; the colours run from 0 to 1.
pub fn figure(rows: &[Vec<Panel>], colormap: Colormap) -> Canvas {
    let row_height = |row: &[Panel]| row.iter().map(|panel| panel.size()[1]).max().unwrap_or(0) + MARGIN[1] + MARGIN[3];
    let row_width = |row: &[Panel]| row.iter().map(|panel| panel.size()[0] + MARGIN[0] + MARGIN[2]).sum::<i32>();
    let width = rows.iter().map(|row| row_width(row)).max().unwrap_or(0) + BAR + BAR_NUMBERS;
    let mut canvas = Canvas::new(width, rows.iter().map(|row| row_height(row)).sum());
    let mut top = MARGIN[1];
    for row in rows {
        let mut left = MARGIN[0];
        for panel in row {
            panel.draw(&mut canvas, [left, top], colormap);
            left += panel.size()[0] + MARGIN[0] + MARGIN[2];
        }
        color_bar(&mut canvas, [left - MARGIN[0], top], row_height(row) - MARGIN[1] - MARGIN[3], colormap);
        top += row_height(row);
    }
    canvas
}

impl Panel {
    /// Width and height of the image, in pixels.
    fn size(&self) -> [i32; 2] {
        let extents = self.axes.each_ref().map(|axis| (axis.high - axis.low) as f32);
        let longest = extents[0].max(extents[1]);
        // A very flat field stays visible.
        extents.map(|extent| ((SIDE * extent / longest).round() as i32).max(24))
    }

    /// The value at a position, bilinearly interpolated. The position is a fraction of the width and of the height.
    fn value(&self, [across, up]: [f32; 2]) -> f32 {
        let rows = self.values.len() / self.columns;
        let (x, y) = (across * (self.columns - 1) as f32, up * (rows - 1) as f32);
        let (column, row) = ((x as usize).min(self.columns - 2), (y as usize).min(rows - 2));
        let along_row = |row: usize| {
            let start = row * self.columns + column;
            let [low, high] = [self.values[start], self.values[start + 1]];
            low + (high - low) * (x - column as f32)
        };
        let (low, high) = (along_row(row), along_row(row + 1));
        low + (high - low) * (y - row as f32)
    }

    fn draw(&self, canvas: &mut Canvas, [left, top]: [i32; 2], colormap: Colormap) {
        let [width, height] = self.size();
        canvas.rectangle([left - 1, top - 1], [width + 2, height + 2], FRAME);
        for y in 0..height {
            for x in 0..width {
                let share = [x as f32 / (width - 1) as f32, 1.0 - y as f32 / (height - 1) as f32];
                canvas.blend(left + x, top + y, colormap.color(self.value(share)), 1.0);
            }
        }
        for point in self.points.iter().step_by(self.points.len().div_ceil(MAX_DOTS).max(1)) {
            let share: [f32; 2] = std::array::from_fn(|i| self.axes[i].share(point[i]));
            if share.iter().all(|share| (0.0..=1.0).contains(share)) {
                let x = left as f32 + share[0] * (width - 1) as f32;
                let y = top as f32 + (1.0 - share[1]) * (height - 1) as f32;
                let [red, green, blue] = colormap.color(self.value(share)).map(f32::from);
                let is_light = 0.3 * red + 0.59 * green + 0.11 * blue > 140.0;
                canvas.disc([x, y], 0.6, if is_light { [0; 3] } else { [255; 3] }, 0.55);
            }
        }
        canvas.text([left + width / 2, top - MARGIN[1] / 2], &self.title, Direction::Right, Bold);
        let [horizontal, vertical] = &self.axes;
        for (position, label) in horizontal.ticks(width / (TEXT_WIDTH * 10)) {
            let x = left + (horizontal.share(position) * (width - 1) as f32).round() as i32;
            canvas.rectangle([x, top + height], [1, 6], FRAME);
            canvas.text([x, top + height + 18], &label, Direction::Right, Regular);
        }
        for (position, label) in vertical.ticks(height / (TEXT_HEIGHT * 3)) {
            let y = top + ((1.0 - vertical.share(position)) * (height - 1) as f32).round() as i32;
            canvas.rectangle([left - 6, y], [6, 1], FRAME);
            let x = left - 12 - label.len() as i32 * TEXT_WIDTH / 2;
            canvas.text([x, y], &label, Direction::Right, Regular);
        }
        canvas.text([left + width / 2, top + height + 40], horizontal.label, Direction::Right, Regular);
        canvas.text([left - MARGIN[0] + 12, top + height / 2], vertical.label, Direction::Up, Regular);
    }
}

impl PanelAxis {
    fn share(&self, position: f64) -> f32 {
        ((position - self.low) / (self.high - self.low)) as f32
    }

    /// Round positions with their labels, about `most` of them at most.
    fn ticks(&self, most: i32) -> Vec<(f64, String)> {
        let (low, high) = (self.low, self.high);
        let rough = (high - low) / f64::from(most.clamp(2, 8));
        let power = 10_f64.powf(rough.log10().floor());
        let step = power * [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= rough).unwrap_or(10.0);
        let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        // The tolerance keeps a tick at an end of the axis despite rounding.
        let (first, last) = ((low / step - 1e-3).ceil() as i64, (high / step + 1e-3).floor() as i64);
        let label = |position: f64| match position {
            0.0 => "0".into(),
            _ if (1e-4..1e5).contains(&step) => format!("{position:.decimals$}"),
            _ => format!("{position:.1e}"),
        };
        (first..=last).map(|i| i as f64 * step).map(|position| (position, label(position))).collect()
    }
}

/// Draws the colour bar, with numbers from 0 to 1.
fn color_bar(canvas: &mut Canvas, [left, top]: [i32; 2], height: i32, colormap: Colormap) {
    canvas.rectangle([left - 1, top - 1], [BAR + 2, height + 2], FRAME);
    for y in 0..height {
        canvas.rectangle([left, top + y], [BAR, 1], colormap.color(1.0 - y as f32 / (height - 1) as f32));
    }
    for fifth in 0..=5 {
        let y = top + (height - 1) * (5 - fifth) / 5;
        canvas.rectangle([left + BAR, y], [6, 1], FRAME);
        let label = format!("{:.1}", f64::from(fifth) / 5.0);
        canvas.text([left + BAR + 12 + TEXT_WIDTH * 3 / 2, y], &label, Direction::Right, Regular);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(low: f64, high: f64) -> PanelAxis {
        PanelAxis { label: "x", low, high }
    }

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        let labels =
            |low, high, most| -> Vec<String> { axis(low, high).ticks(most).into_iter().map(|t| t.1).collect() };
        assert_eq!(labels(-0.55, 0.55, 6), ["-0.4", "-0.2", "0", "0.2", "0.4"]);
        assert_eq!(labels(10.0, 35.0, 5), ["10", "15", "20", "25", "30", "35"]);
        assert_eq!(labels(0.0, 3e-5, 3), ["0", "1.0e-5", "2.0e-5", "3.0e-5"]);
        assert_eq!(labels(0.0, 4e7, 4), ["0", "1.0e7", "2.0e7", "3.0e7", "4.0e7"]);
    }

    #[test]
    fn values_between_pixels_are_linear_and_up_is_up() {
        let axes = [axis(0.0, 1.0), axis(0.0, 2.0)];
        let panel = Panel { title: "t".into(), values: vec![0.0, 1.0, 2.0, 3.0], columns: 2, axes, points: vec![] };
        assert_eq!(panel.size(), [220, 440]);
        for (share, value) in [([0.0, 0.0], 0.0), ([1.0, 0.0], 1.0), ([0.0, 1.0], 2.0), ([0.5, 0.5], 1.5)] {
            assert_eq!(panel.value(share), value);
        }
    }
}

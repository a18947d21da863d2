//! A picture in memory: rectangles, dots, text.

use std::io::{self, Write};

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

/// Red, green, blue.
pub type Color = [u8; 3];

/// Height of a line of text and width of a character, in pixels.
pub const TEXT_HEIGHT: i32 = RasterHeight::Size16.val() as i32;
pub const TEXT_WIDTH: i32 = get_raster_width(FontWeight::Regular, RasterHeight::Size16) as i32;

/// A picture in RGB. Coordinates are pixels from the left and from the top; drawing outside the picture has no effect.
pub struct Canvas {
    width: i32,
    height: i32,
    pixels: Vec<Color>,
}

/// The direction of text.
#[derive(Clone, Copy, PartialEq)]
pub enum Direction {
    Right,
    Up,
}

impl Canvas {
    /// A white picture.
    pub fn new(width: i32, height: i32) -> Self {
        Self { width, height, pixels: vec![[255; 3]; width as usize * height as usize] }
    }

    /// Blends a colour into a pixel; an opacity of 0 keeps the pixel, 1 replaces it.
    pub fn blend(&mut self, x: i32, y: i32, color: Color, opacity: f32) {
        if (0..self.width).contains(&x) && (0..self.height).contains(&y) {
            let pixel = &mut self.pixels[(y * self.width + x) as usize];
            let mix = |old: u8, new: u8| (f32::from(old) + (f32::from(new) - f32::from(old)) * opacity).round() as u8;
            *pixel = std::array::from_fn(|channel| mix(pixel[channel], color[channel]));
        }
    }

    pub fn rectangle(&mut self, [left, top]: [i32; 2], [width, height]: [i32; 2], color: Color) {
        for y in top..top + height {
            for x in left..left + width {
                self.blend(x, y, color, 1.0);
            }
        }
    }

    /// A disc with an antialiased edge; its centre may lie between pixels.
    pub fn disc(&mut self, [x, y]: [f32; 2], radius: f32, color: Color, opacity: f32) {
        let reach = radius.ceil() as i32 + 1;
        let (column, row) = (x.round() as i32, y.round() as i32);
        for pixel_y in row - reach..=row + reach {
            for pixel_x in column - reach..=column + reach {
                let distance = (pixel_x as f32 - x).hypot(pixel_y as f32 - y);
                self.blend(pixel_x, pixel_y, color, opacity * (radius + 0.5 - distance).clamp(0.0, 1.0));
            }
        }
    }

    /// Text centred at a position. A character that the font lacks is drawn as a question mark.
    pub fn text(&mut self, [x, y]: [i32; 2], text: &str, direction: Direction, weight: FontWeight) {
        const INK: Color = [38, 38, 44];
        let length = text.chars().count() as i32 * TEXT_WIDTH;
        let glyph = |c| get_raster(c, weight, RasterHeight::Size16);
        for (index, glyph) in text.chars().filter_map(|c| glyph(c).or_else(|| glyph('?'))).enumerate() {
            for (row, line) in glyph.raster().iter().enumerate() {
                for (column, &ink) in line.iter().enumerate() {
                    let along = index as i32 * TEXT_WIDTH + column as i32 - length / 2;
                    let across = row as i32 - TEXT_HEIGHT / 2;
                    let [x, y] =
                        if direction == Direction::Up { [x + across, y - along] } else { [x + along, y + across] };
                    self.blend(x, y, INK, f32::from(ink) / 255.0);
                }
            }
        }
    }

    pub fn write_png(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        Ok(writer.finish()?)
    }
}

//! Colours for values.

use clap::ValueEnum;

/// Colour scales on which equal steps look equal, but for turbo, which shows more steps.
#[derive(Clone, Copy, ValueEnum)]
pub enum Colormap {
    Viridis,
    Magma,
    Inferno,
    Plasma,
    Cividis,
    Turbo,
    Gray,
}

impl Colormap {
    /// The colour of a share of the range, red, green and blue; beyond the range that of its end.
    pub fn color(self, share: f32) -> [u8; 3] {
        let gradient = match self {
            Self::Viridis => colorous::VIRIDIS,
            Self::Magma => colorous::MAGMA,
            Self::Inferno => colorous::INFERNO,
            Self::Plasma => colorous::PLASMA,
            Self::Cividis => colorous::CIVIDIS,
            Self::Turbo => colorous::TURBO,
            // This one alone runs from light to dark.
            Self::Gray => return [(share.clamp(0.0, 1.0) * 255.0).round() as u8; 3],
        };
        let color = gradient.eval_continuous(share.clamp(0.0, 1.0).into());
        [color.r, color.g, color.b]
    }
}

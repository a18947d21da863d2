//! Colours for values.

use clap::ValueEnum;

/// Colour maps. All of them but turbo, which shows more detail, are perceptually ordered.
#[derive(Clone, Copy, ValueEnum)]
pub enum Colormap {
    Viridis,
    Magma,
    Inferno,
    Plasma,
    Cividis,
    Turbo,
    /// From nearly white to dark red, as in the paper's pictures of the saliency.
    Reds,
    Gray,
}

impl Colormap {
    /// The colour, red, green and blue, of a position from 0 to 1. Positions outside the range are clamped.
    pub fn color(self, share: f32) -> [u8; 3] {
        let gradient = match self {
            Self::Viridis => colorous::VIRIDIS,
            Self::Magma => colorous::MAGMA,
            Self::Inferno => colorous::INFERNO,
            Self::Plasma => colorous::PLASMA,
            Self::Cividis => colorous::CIVIDIS,
            Self::Turbo => colorous::TURBO,
            Self::Reds => colorous::REDS,
            // The gray scale of the crate runs from light to dark.
            Self::Gray => return [(share.clamp(0.0, 1.0) * 255.0).round() as u8; 3],
        };
        let color = gradient.eval_continuous(share.clamp(0.0, 1.0).into());
        [color.r, color.g, color.b]
    }
}

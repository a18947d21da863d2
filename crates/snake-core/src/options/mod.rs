//! Options of encoding, detection and meshes, with their ranges.

mod by_name;
mod detect;
mod encode;
mod mesh;
mod presets;

#[doc(hidden)]
pub use self::by_name::in_words;
pub use self::by_name::option_names;
pub use self::by_name::with_named_values;
pub use self::detect::{DetectOptions, Preference, RefineMethod, Selection};
pub(crate) use self::detect::{Radii, mode_of_scene};
pub use self::encode::EncodeOptions;
pub use self::mesh::{MeshOptions, MeshSurface};
pub use self::presets::Preset;

use serde::{Deserialize, Serialize};
use snake_geometry::{Ranged, setters};

/// All options of [`Model::detect`](crate::Model::detect).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct Options {
    /// Options of encoding.
    pub encode: EncodeOptions,
    /// Options of detection.
    pub detect: DetectOptions,
}

setters!(Options {
    encode: EncodeOptions => with_encode,
    detect: DetectOptions => with_detect,
});

/// An option, or `None` for 0 and null.
fn none_if_zero<'de, T, D>(deserializer: D) -> std::result::Result<Option<T>, D::Error>
where
    T: Deserialize<'de> + Ranged,
    D: serde::Deserializer<'de>,
{
    Ok(Option::<T>::deserialize(deserializer)?.filter(|value| value.outside(0.0, 0.0).is_some()))
}

#[cfg(test)]
mod tests {
    use super::detect::resolution_from;
    use super::*;
    use snake_geometry::{Length, Point, resolution};

    #[test]
    fn a_radius_is_a_length_and_0_is_off() {
        let with = |radius| {
            let options = DetectOptions { mode_radius: radius, ..Default::default() };
            [options.check_ranges(), options.with_nms_radius(radius).with_mode_radius(None).check_ranges()]
        };
        for right in [None, Some(Length::Units(0.06)), Some(Length::Resolutions(2.0)), Some(Length::Percent(8.0))] {
            assert!(with(right).iter().all(Result::is_ok), "{right:?}");
        }
        for wrong in [Length::Units(-1.0), Length::Units(f64::NAN), Length::Units(1e60), Length::Resolutions(-1.0)] {
            let errors = with(Some(wrong)).map(|checked| checked.unwrap_err().to_string());
            assert!(errors[0].contains("mode_radius") && errors[1].contains("nms_radius"), "{errors:?}");
        }
        let off = DetectOptions { mode_radius: Some(Length::Units(0.0)), ..Default::default() };
        assert!(off.check_ranges().is_ok() && off.radii(&[], 1.0, None).unwrap().mode.is_none());
    }

    #[test]
    fn the_resolution_from_a_length_on_is_the_larger_one() {
        let at = |i: u32, factor: u32| (i.wrapping_mul(factor) >> 8) as f32 / (1 << 24) as f32;
        let drawn: Vec<Point> = (0..9000).map(|i| [at(i, 2_654_435_761), at(i, 40_503), 0.1]).collect();
        let grid: Vec<Point> = (0..9000).map(|i| [(i % 90) as f32 * 0.01, (i / 90) as f32 * 0.01, 0.3]).collect();
        for points in [&drawn, &grid, &drawn[..90].repeat(100)] {
            let expected = resolution("points", points).unwrap();
            for share in [0.3, 0.8, 0.99, 1.0, 1.01, 1.2, 1.5, 3.0, 10.0] {
                let from = resolution_from(share * expected, points).unwrap();
                assert_eq!(from, expected.max(share * expected), "{share} {}", points.len());
            }
        }
        assert!(resolution_from(1.0, &[]).is_err());
    }

    #[test]
    fn a_radius_of_0_is_none() {
        let read = |json: &str| serde_json::from_str::<Options>(json).unwrap();
        for off in ["0", "0.0", "null"] {
            assert_eq!(read(&format!("{{\"detect\":{{\"nms_radius\":{off}}}}}")).detect.nms_radius, None, "{off}");
            assert_eq!(read(&format!("{{\"detect\":{{\"mode_radius\":{off}}}}}")).detect.mode_radius, None, "{off}");
        }
        assert_eq!(read(r#"{"detect":{"nms_radius":"3r"}}"#).detect.nms_radius, Some(Length::Resolutions(3.0)));
        assert!(serde_json::from_str::<Options>(r#"{"window":{}}"#).is_err());
    }

    #[test]
    fn options_are_read_as_they_are_written() {
        for preset in Preset::ALL {
            let options = preset.options();
            assert_eq!(Preset::named(preset.name()).unwrap(), preset);
            assert_eq!(serde_json::from_str::<Options>(&serde_json::to_string(&options).unwrap()).unwrap(), options);
        }
        let mut options = Options::default();
        options.detect.mode_radius = Some(Length::Resolutions(40.0));
        options.detect.nms_radius = None;
        assert_eq!(serde_json::from_str::<Options>(&serde_json::to_string(&options).unwrap()).unwrap(), options);
        let error = Preset::named("scannet").unwrap_err().to_string();
        assert!(Preset::ALL.iter().all(|preset| error.contains(preset.name())), "{error}");
    }
}

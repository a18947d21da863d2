//! Coordinate reference systems of laser scans.

use serde::{Deserialize, Serialize};

/// The coordinate reference system of a file.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Crs {
    /// Its text (WKT), as in the file.
    pub wkt: Option<String>,
    /// The EPSG code of its horizontal part.
    pub epsg: Option<u32>,
    /// Whether the coordinates are longitude and latitude in degrees.
    pub is_geographic: bool,
}

impl Crs {
    /// Refuses longitude and latitude, which are not lengths, with advice.
    ///
    /// # Errors
    /// The refusal in words.
    pub fn check_lengths(&self) -> Result<(), &'static str> {
        if self.is_geographic {
            return Err(
                "longitude and latitude in degrees are no lengths; project it to metres first, for example with \
                        `pdal translate in.laz out.laz reprojection --filters.reprojection.out_srs=EPSG:32632`",
            );
        }
        Ok(())
    }
}

impl Crs {
    /// The system that a text describes: WKT of version 1 or 2.
    pub(crate) fn from_wkt(text: &str) -> Self {
        let text = text.trim_end_matches('\0').trim();
        let part = |names: &[&str]| names.iter().find_map(|name| text.find(name).map(|at| element(&text[at..])));
        let projected = part(&["PROJCS[", "PROJCRS[", "PROJECTEDCRS["]);
        let geographic = part(&["GEOGCS[", "GEOGCRS[", "GEODCRS[", "GEOGRAPHICCRS[", "GEODETICCRS["]);
        Self {
            wkt: Some(text.into()),
            epsg: projected.or(geographic).and_then(epsg),
            is_geographic: projected.is_none() && geographic.is_some(),
        }
    }

    /// The system in a directory of GeoTIFF keys.
    pub(crate) fn from_geo_keys(record: &[u8]) -> Option<Self> {
        let numbers: Vec<u16> = record.as_chunks().0.iter().map(|bytes| u16::from_le_bytes(*bytes)).collect();
        // Four numbers of a header, then four numbers per key. If the location is 0, the last number is the value.
        let value = |key: u16| {
            let keys = numbers.get(4..)?.as_chunks::<4>().0;
            keys.iter().find(|[number, location, ..]| (*number, *location) == (key, 0)).map(|[.., value]| *value)
        };
        // 32767 stands for a user-defined system.
        let epsg = |key| value(key).filter(|code| (1024..32767).contains(code)).map(u32::from);
        let is_geographic = value(1024)? == 2;
        Some(Self { wkt: None, epsg: epsg(if is_geographic { 2048 } else { 3072 }), is_geographic })
    }
}

/// The element that a text begins with, up to its closing bracket.
fn element(text: &str) -> &str {
    let mut depth = 0;
    let end = text.char_indices().find(|(_, c)| {
        depth += i32::from(*c == '[') - i32::from(*c == ']');
        *c == ']' && depth == 0
    });
    end.map_or(text, |(end, _)| &text[..=end])
}

/// The EPSG code of an element, which is the last code in it.
fn epsg(element: &str) -> Option<u32> {
    let at = element.rfind("AUTHORITY[\"EPSG\",").or_else(|| element.rfind("ID[\"EPSG\","))?;
    let code: String = element[at..].chars().filter(char::is_ascii_digit).collect();
    code.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const GEOGRAPHIC: &str = r#"GEOGCS["WGS 84",DATUM["WGS_1984",AUTHORITY["EPSG","6326"]],AUTHORITY["EPSG","4326"]]"#;

    #[test]
    fn texts_say_whether_coordinates_are_degrees() {
        let degrees = Crs::from_wkt(&format!("{GEOGRAPHIC}\0"));
        assert_eq!((degrees.epsg, degrees.is_geographic), (Some(4326), true));
        assert_eq!(degrees.wkt.as_deref(), Some(GEOGRAPHIC));
        assert!(degrees.check_lengths().unwrap_err().contains("degrees"));
        let utm = format!(
            r#"COMPD_CS["both",PROJCS["UTM",{GEOGRAPHIC},AUTHORITY["EPSG","25832"]],VERT_CS["h",AUTHORITY["EPSG","7837"]]]"#
        );
        let metres = Crs::from_wkt(&utm);
        assert_eq!((metres.epsg, metres.is_geographic), (Some(25832), false));
        assert_eq!(metres.check_lengths(), Ok(()));
        assert_eq!(Crs::from_wkt(r#"PROJCRS["x",BASEGEOGCRS["y"],ID["EPSG",2056]]"#).epsg, Some(2056));
        assert_eq!(Crs::from_wkt("LOCAL_CS[\"site\"]").epsg, None);
    }

    #[test]
    fn keys_say_the_same() {
        let keys =
            |numbers: &[u16]| Crs::from_geo_keys(&numbers.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<_>>());
        let metres = keys(&[1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 25832]).unwrap();
        assert_eq!((metres.epsg, metres.is_geographic), (Some(25832), false));
        let degrees = keys(&[1, 1, 0, 2, 1024, 0, 1, 2, 2048, 0, 1, 4326]).unwrap();
        assert_eq!((degrees.epsg, degrees.is_geographic), (Some(4326), true));
        assert_eq!(keys(&[1, 1, 0]), None);
        assert_eq!(keys(&[]), None);
    }
}

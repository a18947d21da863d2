//! Finds the columns of a table that hold x, y and z: by names that common programs use, or by the caller's choice.

use std::str::FromStr;

use serde::Serialize;

use crate::Error;
use snake_geometry::excerpt;

/// The columns that hold x, y and z, chosen by name or by position.
///
/// The text form is three names or three numbers counted from 1: `Points:0,Points:1,Points:2` or `4,5,6`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Columns(pub [Column; 3]);

/// One column of a table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Column {
    /// By its name, in upper or lower case, with or without its unit: `X (m)` or `x`.
    Name(String),
    /// By its position, counted from 0.
    Index(usize),
}

/// Indices of the columns of x, y and z, counted from 0.
pub(crate) type Indices = [usize; 3];

/// Column names in lower case and without units, the likeliest set first.
const KNOWN: [Names; 18] = [
    ["x", "y", "z"],
    // TUM trajectories.
    ["tx", "ty", "tz"],
    // ParaView before and after version 5.13, and VeloView.
    ["points:0", "points:1", "points:2"],
    ["points_0", "points_1", "points_2"],
    ["points_m_xyz:0", "points_m_xyz:1", "points_m_xyz:2"],
    ["points_m_xyz_0", "points_m_xyz_1", "points_m_xyz_2"],
    // GIS and surveying programs.
    ["point_x", "point_y", "point_z"],
    ["easting", "northing", "elevation"],
    ["easting", "northing", "height"],
    ["easting", "northing", "altitude"],
    ["east", "north", "up"],
    // Hand-made tables, and ROS messages as text.
    ["x_m", "y_m", "z_m"],
    ["px", "py", "pz"],
    ["pos_x", "pos_y", "pos_z"],
    ["position_x", "position_y", "position_z"],
    ["position.x", "position.y", "position.z"],
    ["x_coord", "y_coord", "z_coord"],
    ["coord_x", "coord_y", "coord_z"],
];

type Names = [&'static str; 3];

/// Names of columns in degrees, in lower case and without units.
const DEGREES: [&str; 6] = ["lon", "long", "lng", "longitude", "lat", "latitude"];

impl FromStr for Columns {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let refused = |reason: &str| Error::Input { what: "columns", reason: format!("`{text}`: {reason}") };
        let column = |word: &str| match word.trim().parse::<usize>() {
            Ok(number) => number.checked_sub(1).map(Column::Index).ok_or_else(|| refused("numbers begin at 1")),
            Err(_) if word.trim().is_empty() => Err(refused("a name is empty")),
            Err(_) => Ok(Column::Name(word.trim().into())),
        };
        let columns = text.split(',').map(column).collect::<Result<Vec<_>, _>>()?;
        columns.try_into().map(Self).map_err(|_| refused("three names or numbers are needed, such as x,y,z or 4,5,6"))
    }
}

impl Columns {
    /// Finds the columns of an array, which has no names.
    pub(crate) fn in_array(&self) -> Result<Indices, String> {
        self.indices(|name| Err(format!("an array has no column `{}`; choose columns by numbers", excerpt(name, 40))))
    }

    /// Finds the columns of text; `names` is empty without a header. Columns in degrees are refused, even if chosen.
    pub(crate) fn in_text(&self, names: &[String]) -> Result<Indices, String> {
        let [x, y, z] = self.in_header(names)?;
        let is_degrees = |column: usize| names.get(column).is_some_and(|name| DEGREES.contains(&&plain(name)[..]));
        if is_degrees(x) && is_degrees(y) { Err(degrees(names)) } else { Ok([x, y, z]) }
    }

    /// Finds the columns by names or numbers, including columns in degrees.
    pub(crate) fn in_header(&self, names: &[String]) -> Result<Indices, String> {
        self.indices(|wanted| {
            let is_wanted = |name: &&String| clean(name).eq_ignore_ascii_case(wanted) || plain(name) == plain(wanted);
            let shown = excerpt(wanted, 40);
            match names.iter().filter(is_wanted).count() {
                _ if names.is_empty() => Err(format!("no header names a column `{shown}`; choose columns by numbers")),
                0 => Err(format!("no column `{shown}`; the columns are {}", listed(names))),
                1 => Ok(names.iter().position(|name| is_wanted(&name)).unwrap_or_default()),
                _ => Err(format!("several columns `{shown}`; choose by numbers. The columns are {}", listed(names))),
            }
        })
    }

    /// Whether the columns are chosen by numbers only.
    pub(crate) fn are_numbers(&self) -> bool {
        self.0.iter().all(|column| matches!(column, Column::Index(_)))
    }

    /// Whether columns are chosen by names that a header has.
    pub(crate) fn are_named_in(&self, names: &[String]) -> bool {
        !self.are_numbers() && self.in_header(names).is_ok()
    }

    fn indices(&self, index_of: impl Fn(&str) -> Result<usize, String>) -> Result<Indices, String> {
        let index = |column: &Column| match column {
            Column::Name(name) => index_of(name),
            Column::Index(index) => Ok(*index),
        };
        let [x, y, z] = self.0.each_ref().map(index);
        match (x?, y?, z?) {
            (x, y, z) if x == y || y == z || x == z => Err("one column is chosen twice for x, y and z".into()),
            (x, y, z) => Ok([x, y, z]),
        }
    }
}

/// The columns of x, y and z in a header: the first known set whose names all occur; `None` if one occurs twice.
pub(crate) fn known(names: &[String]) -> Option<Indices> {
    let plain: Vec<String> = names.iter().map(|name| plain(name)).collect();
    let count = |name: &str| plain.iter().filter(|known| *known == name).count();
    let column = |name: &str| plain.iter().position(|known| known == name);
    if is_numbered(names) {
        return Some([1, 2, 3]);
    }
    let [x, y, z] = *KNOWN.iter().find(|set| set.iter().all(|name| count(name) > 0))?;
    if [x, y, z].iter().any(|name| count(name) > 1) {
        return None;
    }
    Some([column(x)?, column(y)?, column(z)?])
}

/// Whether these are the names that pandas gives to a plain array: an empty name for the index, then 0, 1, 2, ...
pub(crate) fn is_numbered(names: &[String]) -> bool {
    names.len() > 3
        && names[0].is_empty()
        && names[1..].iter().enumerate().all(|(number, name)| *name == number.to_string())
}

/// The error for unknown columns, with the way to choose them.
pub(crate) fn cannot_tell(names: &[String]) -> String {
    let begins = |start: &str| names.iter().any(|name| plain(name).starts_with(start));
    if begins("lat") && begins("lon") {
        return degrees(names);
    }
    format!(
        "the header does not say which columns are x, y and z: choose them by names or numbers, as in `columns` x,y,z. \
         The columns are {}",
        listed(names)
    )
}

/// The error for columns of degrees.
fn degrees(names: &[String]) -> String {
    format!(
        "latitude and longitude are degrees and no lengths: project them to metres first, for example with cs2cs of PROJ, \
         and choose the columns with `columns` x,y,z. The columns are {}",
        listed(names)
    )
}

/// Lists columns with their numbers counted from 1.
fn listed(names: &[String]) -> String {
    let all: Vec<String> = (1..).zip(names).map(|(number, name)| format!("{number} `{}`", excerpt(name, 40))).collect();
    excerpt(&all.join(", "), 500)
}

/// A name without comment marks and quotes.
fn clean(name: &str) -> &str {
    name.trim_matches(|c: char| c.is_whitespace() || matches!(c, '#' | '/' | '"' | '\''))
}

/// A name in lower case, without a unit in parentheses or brackets.
pub(crate) fn plain(name: &str) -> String {
    let name = clean(name);
    name.split(['(', '[']).next().unwrap_or_default().trim_end().to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| name.to_string()).collect()
    }

    #[test]
    fn chosen_columns_are_found_or_the_columns_are_listed() {
        let header = names(&["t", "X (m)", "Y (m)", "height", "height"]);
        let of = |text: &str| text.parse::<Columns>().unwrap().in_text(&header);
        assert_eq!(of("x,Y (m),1").unwrap(), [1, 2, 0]);
        assert_eq!(of("3, 2,5").unwrap(), [2, 1, 4]);
        assert!("x,,z".parse::<Columns>().unwrap_err().to_string().contains("empty"));
        assert!(of("x,y,up").unwrap_err().contains("no column `up`; the columns are 1 `t`, 2 `X (m)`, 3 `Y (m)`"));
        assert!(of("x,y,height").unwrap_err().contains("several columns `height`"));
        assert!(of("x,2,y").unwrap_err().contains("twice"));
        let columns: Columns = "x,y,z".parse().unwrap();
        assert!(columns.in_text(&[]).unwrap_err().contains("no header") && columns.in_array().is_err());
        assert_eq!("4,5,6".parse::<Columns>().unwrap().in_array().unwrap(), [3, 4, 5]);
    }

    #[test]
    fn chosen_degrees_are_refused() {
        let header = names(&["Lon", "lat (deg)", "alt", "x", "y"]);
        for text in ["lon,lat,alt", "lat,lon,alt", "1,2,3"] {
            let error = text.parse::<Columns>().unwrap().in_text(&header).unwrap_err();
            assert!(error.contains("degrees and no lengths"), "{text}: {error}");
        }
        assert_eq!("x,y,alt".parse::<Columns>().unwrap().in_text(&header).unwrap(), [3, 4, 2]);
    }

    #[test]
    fn names_that_occur_twice_tell_nothing() {
        assert_eq!(known(&names(&["x", "y", "z", "tx", "ty", "tz"])), Some([0, 1, 2]));
        assert_eq!(known(&names(&["x", "y", "z", "X (m)"])), None);
        assert_eq!(known(&names(&["x", "y", "intensity"])), None);
    }
}

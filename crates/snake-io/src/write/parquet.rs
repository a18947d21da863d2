//! Writes keypoints as Parquet with the metadata of GeoParquet 1.1.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::Compression;
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::Result;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use serde_json::{Value, json};
use snake_geometry::{Bounds, Keypoint, add_origin};

use crate::crs::Crs;
use crate::write::keypoint_source::KeypointSource;

/// Rows that are written together.
const ROWS: usize = 1 << 18;

/// Writes the columns `geometry` (WKB points with z), x, y, z, saliency, occupancy, nearest_index and confidence, and `tile` if the
/// keypoints have tiles.
pub(crate) fn write(out: &mut dyn Write, keypoints: &[Keypoint], source: &KeypointSource) -> io::Result<()> {
    // The writer of the crate must be `Send`, which `out` is not.
    let mut bytes = Vec::new();
    write_bytes(&mut bytes, keypoints, source).map_err(io::Error::other)?;
    out.write_all(&bytes)
}

fn write_bytes(out: &mut Vec<u8>, keypoints: &[Keypoint], source: &KeypointSource) -> Result<()> {
    let has_tiles = source.tiles.len() == keypoints.len() && !keypoints.is_empty();
    let tile = if has_tiles { "required binary tile (UTF8);" } else { "" };
    let schema = parse_message_type(&format!(
        "message keypoints {{ required binary geometry; required double x; required double y; required double z;
         required float saliency; required float occupancy; required int64 nearest_index; required float confidence; {tile} }}"
    ))?;
    let mut metadata = vec![KeyValue::new("geo".into(), geo(keypoints, source).to_string())];
    if let Some(Crs { wkt: Some(wkt), .. }) = &source.crs {
        metadata.push(KeyValue::new("crs_wkt".into(), wkt.clone()));
    }
    if let Some(Crs { epsg: Some(code), .. }) = &source.crs {
        metadata.push(KeyValue::new("crs_epsg".into(), code.to_string()));
    }
    let properties =
        WriterProperties::builder().set_compression(Compression::SNAPPY).set_key_value_metadata(Some(metadata)).build();
    let mut writer = SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties))?;
    for (number, keypoints) in keypoints.chunks(ROWS).enumerate() {
        let positions: Vec<[f64; 3]> = keypoints.iter().map(|k| add_origin(k.position, source.origin)).collect();
        let mut group = writer.next_row_group()?;
        column::<ByteArrayType>(&mut group, positions.iter().map(|&position| wkb(position)))?;
        for axis in 0..3 {
            column::<DoubleType>(&mut group, positions.iter().map(|position| position[axis]))?;
        }
        column::<FloatType>(&mut group, keypoints.iter().map(|k| k.saliency))?;
        column::<FloatType>(&mut group, keypoints.iter().map(|k| k.occupancy))?;
        column::<Int64Type>(&mut group, keypoints.iter().map(|k| k.nearest_index as i64))?;
        column::<FloatType>(&mut group, keypoints.iter().map(|k| k.confidence.unwrap_or(f32::NAN)))?;
        if has_tiles {
            let tiles = &source.tiles[number * ROWS..][..keypoints.len()];
            column::<ByteArrayType>(&mut group, tiles.iter().map(|[x, y]| format!("{x}_{y}").into_bytes().into()))?;
        }
        group.close()?;
    }
    writer.close()?;
    Ok(())
}

/// Writes the next column of a group of rows.
fn column<T: DataType>(
    group: &mut SerializedRowGroupWriter<&mut Vec<u8>>,
    values: impl Iterator<Item = T::T>,
) -> Result<()> {
    let Some(mut column) = group.next_column()? else { return Ok(()) };
    column.typed::<T>().write_batch(&values.collect::<Vec<_>>(), None, None)?;
    column.close()
}

/// A point as well-known binary: byte order, type 1001 (a point with z), coordinates.
fn wkb(position: [f64; 3]) -> ByteArray {
    let mut bytes = vec![1];
    bytes.extend(1001_u32.to_le_bytes());
    bytes.extend(position.iter().flat_map(|v| v.to_le_bytes()));
    bytes.into()
}

/// The metadata of GeoParquet.
fn geo(keypoints: &[Keypoint], source: &KeypointSource) -> Value {
    let mut bounds = Bounds::default();
    keypoints.iter().for_each(|k| bounds.add(add_origin(k.position, source.origin)));
    let mut column = json!({
        "encoding": "WKB",
        "geometry_types": ["Point Z"],
        // Without this key readers would take the coordinates for longitude and latitude.
        "crs": source.crs.as_ref().and_then(|crs| crs.epsg).and_then(utm),
    });
    if !keypoints.is_empty() {
        column["bbox"] = json!([bounds.low, bounds.high].concat());
    }
    json!({"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}})
}

/// The PROJJSON of a UTM zone of WGS 84, ETRS89 or NAD83. Other systems need a database; their code is in `crs_epsg`.
fn utm(code: u32) -> Option<Value> {
    let wgs = ("WGS 84", "World Geodetic System 1984", 4326, 298.257_223_563);
    let etrs = ("ETRS89", "European Terrestrial Reference System 1989", 4258, 298.257_222_101);
    let nad = ("NAD83", "North American Datum 1983", 4269, 298.257_222_101);
    let ((name, datum, base, flattening), zone, is_south) = match code {
        32601..=32660 => (wgs, code - 32600, false),
        32701..=32760 => (wgs, code - 32700, true),
        25828..=25838 => (etrs, code - 25800, false),
        26901..=26923 => (nad, code - 26900, false),
        _ => return None,
    };
    let zone_name = format!("UTM zone {zone}{}", if is_south { "S" } else { "N" });
    let ellipsoid = if base == 4326 { "WGS 84" } else { "GRS 1980" };
    let id = |code: u32| json!({"authority": "EPSG", "code": code});
    let axis = |name, abbreviation, direction, unit| json!({"name": name, "abbreviation": abbreviation, "direction": direction, "unit": unit});
    let parameter = |name, value: f64, unit, code| json!({"name": name, "value": value, "unit": unit, "id": id(code)});
    Some(json!({
        "$schema": "https://proj.org/schemas/v0.7/projjson.schema.json",
        "type": "ProjectedCRS",
        "name": format!("{name} / {zone_name}"),
        "base_crs": {
            "type": "GeographicCRS",
            "name": name,
            "datum": {
                "type": "GeodeticReferenceFrame",
                "name": datum,
                "ellipsoid": {"name": ellipsoid, "semi_major_axis": 6_378_137, "inverse_flattening": flattening},
            },
            "coordinate_system": {"subtype": "ellipsoidal", "axis": [
                axis("Geodetic latitude", "Lat", "north", "degree"),
                axis("Geodetic longitude", "Lon", "east", "degree"),
            ]},
            "id": id(base),
        },
        "conversion": {
            "name": zone_name,
            "method": {"name": "Transverse Mercator", "id": id(9807)},
            "parameters": [
                parameter("Latitude of natural origin", 0.0, "degree", 8801),
                parameter("Longitude of natural origin", f64::from(zone) * 6.0 - 183.0, "degree", 8802),
                parameter("Scale factor at natural origin", 0.9996, "unity", 8805),
                parameter("False easting", 500_000.0, "metre", 8806),
                parameter("False northing", if is_south { 10_000_000.0 } else { 0.0 }, "metre", 8807),
            ],
        },
        "coordinate_system": {"subtype": "Cartesian", "axis": [
            axis("Easting", "E", "east", "metre"),
            axis("Northing", "N", "north", "metre"),
        ]},
        "id": id(code),
    }))
}

#[cfg(test)]
mod tests {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;

    use super::*;
    use crate::tests::KEYPOINTS;

    #[test]
    fn keypoints_read_back_with_tiles_and_the_reference_system() {
        let crs = Some(Crs { epsg: Some(25832), ..Crs::default() });
        let origin = [500_000.0, 5_400_000.0, 0.0];
        let source = KeypointSource { origin, crs, tiles: vec![[3, -1], [0, 12]], ..KeypointSource::default() };
        let mut bytes = Vec::new();
        write(&mut bytes, &KEYPOINTS, &source).unwrap();
        let reader = SerializedFileReader::new(bytes::Bytes::from(bytes)).unwrap();
        let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 2);
        for (row, (keypoint, tile)) in rows.iter().zip(KEYPOINTS.iter().zip(["3_-1", "0_12"])) {
            let position = add_origin(keypoint.position, origin);
            assert_eq!([1, 2, 3].map(|column| row.get_double(column).unwrap()), position);
            assert_eq!(row.get_bytes(0).unwrap().data()[5..13], position[0].to_le_bytes());
            assert_eq!([4, 5].map(|column| row.get_float(column).unwrap()), [keypoint.saliency, keypoint.occupancy]);
            assert_eq!(row.get_long(6).unwrap(), keypoint.nearest_index as i64);
            assert_eq!(row.get_string(8).unwrap(), tile);
        }
        let metadata = reader.metadata().file_metadata().key_value_metadata().unwrap();
        let value = |key: &str| metadata.iter().find(|pair| pair.key == key).and_then(|pair| pair.value.clone());
        let geo: Value = serde_json::from_str(&value("geo").unwrap()).unwrap();
        let column = &geo["columns"]["geometry"];
        assert_eq!(column["crs"]["name"], "ETRS89 / UTM zone 32N");
        assert_eq!(column["bbox"][0], add_origin(KEYPOINTS[0].position, origin)[0]);
        assert_eq!(value("crs_epsg").unwrap(), "25832");
    }

    #[test]
    fn no_keypoints_and_unknown_systems_are_written_too() {
        for (epsg, expected) in [(None, Value::Null), (Some(2056), Value::Null)] {
            let source = KeypointSource { crs: Some(Crs { epsg, ..Crs::default() }), ..KeypointSource::default() };
            let mut bytes = Vec::new();
            write(&mut bytes, &[], &source).unwrap();
            assert!(bytes.starts_with(b"PAR1") && bytes.ends_with(b"PAR1"));
            assert_eq!(geo(&[], &source)["columns"]["geometry"]["crs"], expected);
        }
    }
}

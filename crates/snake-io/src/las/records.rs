//! The records of a LAS file that are not points.

use std::ops::Range;

use laz::LazVlr;

use super::{Header, field};
use crate::crs::Crs;

impl Header {
    /// The variable length records between header and points: user, number and content.
    pub(crate) fn records<'a>(&self, head: &'a [u8]) -> impl Iterator<Item = (&'a [u8], u16, &'a [u8])> {
        let mut rest = head.get(self.records_offset..).unwrap_or_default();
        (0..self.num_records).map_while(move |_| {
            let (head, tail) = rest.split_at_checked(54)?;
            let (record, tail) = tail.split_at_checked(u16::from_le_bytes(field(head, 20)?).into())?;
            rest = tail;
            Some((&head[2..18], u16::from_le_bytes(field(head, 18)?), record))
        })
    }

    /// The variable length record of LASzip.
    pub(crate) fn laszip_record<'a>(&self, head: &'a [u8]) -> Option<&'a [u8]> {
        let is_laszip =
            |user: &[u8], number| user.starts_with(LazVlr::USER_ID.as_bytes()) && number == LazVlr::RECORD_ID;
        let mut records = self.records(head).filter(|(user, number, _)| is_laszip(user, *number));
        records.next().map(|(.., record)| record).filter(|record| record.len() >= 2)
    }

    /// The coordinate reference system, as text or as the keys of GeoTIFF. `read` reads bytes of the file.
    pub(crate) fn crs(&self, head: &[u8], read: &mut dyn FnMut(Range<u64>) -> Option<Vec<u8>>) -> Option<Crs> {
        let projection_record = |wanted: u16| {
            let mut records = self.records(head).filter(|(user, ..)| user.starts_with(b"LASF_Projection"));
            records.find(|(_, number, _)| *number == wanted).map(|(.., record)| record)
        };
        let text = |record: &[u8]| Crs::from_wkt(&String::from_utf8_lossy(record));
        let crs = projection_record(2112).map(text);
        let crs = crs.or_else(|| projection_record(34735).and_then(Crs::from_geo_keys));
        crs.or_else(|| self.extended_text(read).map(|record| text(&record)))
    }

    /// The text of the coordinate reference system in a record after the points.
    fn extended_text(&self, read: &mut dyn FnMut(Range<u64>) -> Option<Vec<u8>>) -> Option<Vec<u8>> {
        let (mut start, number) = self.extended;
        for _ in 0..number.min(100) {
            let content = start.checked_add(60)?;
            let head = read(start..content)?;
            start = content.checked_add(u64::from_le_bytes(field(&head, 20)?))?;
            if head[2..].starts_with(b"LASF_Projection\0") && field(&head, 18)? == 2112_u16.to_le_bytes() {
                return if start - content <= 1 << 20 { read(content..start) } else { None };
            }
        }
        None
    }
}

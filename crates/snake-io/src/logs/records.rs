//! The MCAP records that are read (<https://mcap.dev/spec>). Numbers are little-endian; a text follows its length.

/// The first and the last bytes of a file.
pub(crate) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

/// The kinds of records.
pub(crate) mod kind {
    pub(crate) const SCHEMA: u8 = 3;
    pub(crate) const CHANNEL: u8 = 4;
    pub(crate) const MESSAGE: u8 = 5;
    pub(crate) const CHUNK: u8 = 6;
    pub(crate) const DATA_END: u8 = 15;
}

/// A record.
pub(crate) enum Record<'a> {
    /// The type of messages.
    Schema { id: u16, name: String },
    /// The messages of one writer to a topic.
    Channel { id: u16, schema_id: u16, topic: String, encoding: String },
    /// A message, with its time in nanoseconds.
    Message { channel_id: u16, log_time: u64, data: &'a [u8] },
    /// A record of another kind.
    Other,
}

impl<'a> Record<'a> {
    /// The record of a kind and a content.
    pub(crate) fn parse(kind: u8, content: &'a [u8]) -> Result<Self, String> {
        let mut fields = Fields(content);
        Ok(match kind {
            kind::SCHEMA => Self::Schema { id: fields.u16()?, name: fields.text()? },
            kind::CHANNEL => Self::Channel {
                id: fields.u16()?,
                schema_id: fields.u16()?,
                topic: fields.text()?,
                encoding: fields.text()?,
            },
            kind::MESSAGE => {
                let channel_id = fields.u16()?;
                fields.take(4)?;
                let log_time = fields.u64()?;
                fields.take(8)?;
                Self::Message { channel_id, log_time, data: fields.0 }
            }
            _ => Self::Other,
        })
    }
}

/// The remaining fields of a record.
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    pub(crate) fn take(&mut self, length: usize) -> Result<&'a [u8], String> {
        self.0.split_off(..length).ok_or_else(|| "it is cut short".into())
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        Ok(self.take(N)?.try_into().unwrap_or([0; N]))
    }

    fn u16(&mut self) -> Result<u16, String> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    pub(crate) fn u32(&mut self) -> Result<u32, String> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub(crate) fn u64(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    pub(crate) fn text(&mut self) -> Result<String, String> {
        let length = self.u32()? as usize;
        String::from_utf8(self.take(length)?.to_vec()).map_err(|error| error.to_string())
    }
}

//! The records in a chunk of an MCAP file: compressed with zstd or lz4, or uncompressed.

use std::io::{self, Read};

use lz4_flex::frame::FrameDecoder as Lz4;
use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

use crate::logs::records::Fields;

/// A last zstd block without content, and a checksum, which is not checked: a chunk has its own.
const ZSTD_END: &[u8] = &[1, 0, 0, 0, 0, 0, 0];

/// Every zstd decoder accepts windows of 8 MiB (RFC 8878). Larger windows are accepted if the file is large.
const MIN_WINDOW: usize = 8 << 20;

/// Calls `add` with the kind and the content of each record in the body of a chunk, which may be cut short. A record
/// of more than `max_bytes` counts as damaged.
///
/// # Errors
/// The damage, after the records before it. A wrong checksum is reported after all records.
pub(crate) fn for_each_record(
    body: &[u8],
    max_bytes: usize,
    mut add: impl FnMut(u8, &[u8]) -> Result<(), String>,
) -> Result<(), String> {
    let damaged = |reason: String| format!("a chunk is damaged, and its messages are left out: {reason}");
    let mut fields = Fields(body);
    let mut head = || {
        // The times of the first and the last message are skipped.
        fields.take(16)?;
        let head = (fields.u64()?, fields.u32()?, fields.text()?);
        fields.take(8)?;
        Ok((head, fields.0))
    };
    let ((size, checksum, compression), body) = head().map_err(damaged)?;
    let data: Box<dyn Read> = match &*compression {
        "" => Box::new(body),
        "lz4" => Box::new(Lz4::new(body)),
        "zstd" => Box::new(Zstd::new(body, max_bytes.max(MIN_WINDOW))),
        name => {
            return Err(format!(
                "chunks compressed with `{name}`, which is not read; convert it: mcap compress --compression zstd IN.mcap -o \
                 OUT.mcap"
            ));
        }
    };
    let mut data = data.take(size);
    let mut actual = crc32fast::Hasher::new();
    let mut record = Vec::new();
    while data.limit() > 0 {
        let mut head = [0; 9];
        data.read_exact(&mut head).map_err(|error| damaged(error.to_string()))?;
        let [kind, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        if length > max_bytes as u64 || length > data.limit() {
            return Err(damaged(format!("a record of {length} bytes")));
        }
        record.clear();
        data.by_ref().take(length).read_to_end(&mut record).map_err(|error| damaged(error.to_string()))?;
        if (record.len() as u64) < length {
            return Err(damaged("cut short".into()));
        }
        actual.update(&head);
        actual.update(&record);
        add(kind, &record)?;
    }
    match (checksum, actual.finalize()) {
        (0, _) => Ok(()),
        (expected, actual) if expected == actual => Ok(()),
        (expected, actual) => Err(damaged(format!("its checksum is {actual:08x}, not {expected:08x}"))),
    }
}

/// Consecutive zstd frames. If the data are cut short, all whole blocks are decoded.
struct Zstd<'a> {
    data: &'a [u8],
    decoder: FrameDecoder,
}

impl<'a> Zstd<'a> {
    fn new(data: &'a [u8], max_window: usize) -> Self {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(max_window as u64);
        Self { data, decoder }
    }

    /// Begins the next frame; skips frames without content.
    fn begin_frame(&mut self) -> io::Result<()> {
        match self.decoder.init(&mut self.data) {
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame { length, .. })) => {
                self.data = self.data.get(length as usize..).unwrap_or_default();
                Ok(())
            }
            result => result.map_err(io::Error::other),
        }
    }
}

impl Read for Zstd<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.decoder.can_collect() == 0 {
            if self.decoder.is_finished() {
                if self.data.is_empty() {
                    return Ok(0);
                }
                self.begin_frame()?;
            } else if let Err(error) = self.decoder.decode_blocks(&mut self.data, BlockDecodingStrategy::UptoBlocks(1))
            {
                // Until the end of a frame, the decoder holds back a window of decoded data.
                if !self.data.is_empty() {
                    return Err(io::Error::other(error));
                }
                self.decoder.decode_blocks(ZSTD_END, BlockDecodingStrategy::All).map_err(io::Error::other)?;
            }
        }
        self.decoder.read(buffer)
    }
}

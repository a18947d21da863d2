//! Decodes the GPS times of LAZ files, which are stored between the coordinates of consecutive points.
//!
//! A point can refer to another sequence of times. `laz` follows such references by recursion, without a limit in a
//! damaged file: the stack overflows and the process dies. This is the same decoder (LASzip's version 2) with a loop.

use std::io::{Read, Result};

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::{IntegerDecompressor, IntegerDecompressorBuilder};
use laz::models::{ArithmeticModel, ArithmeticModelBuilder};
use laz::record::FieldDecompressor;

/// The code of a time that is 500 or more steps later. Codes 2 to 499 are the number of steps; codes 501 to 509 mean
/// -1 to -9 steps.
const MANY: i32 = 500;
/// The code of a time that is 10 steps or more earlier.
const MINUS: i32 = MANY + 10;
/// This code means: the same time again. The next code begins a new sequence, and the codes after that select another.
const UNCHANGED: i32 = MANY + 11;
/// The number of differences that do not fit before the step is replaced.
const MISFITS: u32 = 3;

/// Up to four interleaved sequences of times.
pub(crate) struct GpsTimes {
    sequences: [Sequence; 4],
    last: usize,
    newest: usize,
    after_no_step: ArithmeticModel,
    after_step: ArithmeticModel,
    numbers: IntegerDecompressor,
}

#[derive(Default, Clone, Copy)]
struct Sequence {
    /// The bits of an f64.
    time: i64,
    step: i32,
    misfits: u32,
}

impl Default for GpsTimes {
    fn default() -> Self {
        Self {
            sequences: [Sequence::default(); 4],
            last: 0,
            newest: 0,
            after_no_step: ArithmeticModelBuilder::new(6).build(),
            after_step: ArithmeticModelBuilder::new(MANY as u32 + 16).build(),
            numbers: IntegerDecompressorBuilder::new().bits(32).contexts(9).build_initialized(),
        }
    }
}

impl<R: Read> FieldDecompressor<R> for GpsTimes {
    fn size_of_field(&self) -> usize {
        size_of::<i64>()
    }

    fn decompress_first(&mut self, source: &mut R, first: &mut [u8]) -> Result<()> {
        let mut bytes = [0; 8];
        source.read_exact(&mut bytes)?;
        self.sequences[0].time = i64::from_le_bytes(bytes);
        first.copy_from_slice(&bytes);
        Ok(())
    }

    fn decompress_with(&mut self, decoder: &mut ArithmeticDecoder<R>, time: &mut [u8]) -> Result<()> {
        // Every iteration consumes data, so the loop ends.
        while let Some(other) = self.next(decoder)? {
            self.last = (self.last + other) % 4;
        }
        time.copy_from_slice(&self.sequences[self.last].time.to_le_bytes());
        Ok(())
    }
}

impl GpsTimes {
    /// Decodes a time and returns `None`, or returns how many sequences further to look for it.
    fn next<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> Result<Option<usize>> {
        let sequence = &mut self.sequences[self.last];
        if sequence.step == 0 {
            match decoder.decode_symbol(&mut self.after_no_step)? {
                0 => {}
                1 => {
                    sequence.step = self.numbers.decompress(decoder, 0, 0)?;
                    sequence.time = sequence.time.wrapping_add(sequence.step.into());
                    sequence.misfits = 0;
                }
                2 => self.begin(decoder)?,
                code => return Ok(Some(code as usize - 2)),
            }
            return Ok(None);
        }
        let code = decoder.decode_symbol(&mut self.after_step)? as i32;
        let (multiple, context) = match code {
            1 => (1, 1),
            0 => (0, 7),
            2..10 => (code, 2),
            10..MANY => (code, 3),
            MANY => (MANY, 4),
            _ if code < MINUS => (MANY - code, 5),
            MINUS => (MANY - MINUS, 6),
            UNCHANGED => return Ok(None),
            _ if code == UNCHANGED + 1 => return self.begin(decoder).map(|()| None),
            _ => return Ok(Some((code - UNCHANGED) as usize - 1)),
        };
        let step = self.numbers.decompress(decoder, sequence.step.wrapping_mul(multiple), context)?;
        sequence.time = sequence.time.wrapping_add(step.into());
        match multiple {
            1 => sequence.misfits = 0,
            0 | MANY | -10 => {
                sequence.misfits += 1;
                if sequence.misfits > MISFITS {
                    (sequence.step, sequence.misfits) = (step, 0);
                }
            }
            _ => {}
        }
        Ok(None)
    }

    /// Begins a new sequence in place of the oldest.
    fn begin<R: Read>(&mut self, decoder: &mut ArithmeticDecoder<R>) -> Result<()> {
        let upper = (self.sequences[self.last].time >> 32) as i32;
        let upper = self.numbers.decompress(decoder, upper, 8)?;
        let time = i64::from(upper) << 32 | i64::from(decoder.read_int()?);
        self.newest = (self.newest + 1) % 4;
        self.last = self.newest;
        self.sequences[self.last] = Sequence { time, ..Sequence::default() };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use laz::las::v2::{GpsTimeCompressor, GpsTimeDecompressor};
    use laz::record::{
        RecordCompressor, RecordDecompressor, SequentialPointRecordCompressor, SequentialPointRecordDecompressor,
    };

    use super::*;

    /// Times that use every code: regular and irregular steps, back and forth, and five interleaved sequences.
    fn times() -> Vec<i64> {
        let steps = [0, 0, 1000, 1000, 1001, 2000, 49_000, 499_000, 3_000_000, -7000, -9000, -40_000, 3, 0, 1000, 1];
        let mut times: Vec<i64> = (0..2000).map(|i| steps[i * i % 16] + steps[i / 16 % 16]).collect();
        (1..times.len()).for_each(|i| times[i] += times[i - 1]);
        for (i, time) in times.iter_mut().enumerate().skip(500) {
            *time += [0, 1, 1, 2, 0, 3, 4, 1][i / (1 + i % 3) % 8] << 40;
        }
        times
    }

    #[test]
    fn times_are_those_that_were_written_and_that_laz_reads() {
        let mut compressor = SequentialPointRecordCompressor::new(Vec::new());
        compressor.add_field_compressor(GpsTimeCompressor::default());
        for time in times() {
            compressor.compress_next(&time.to_le_bytes()).unwrap();
        }
        compressor.done().unwrap();
        let bytes = compressor.into_inner();
        let mut ours = SequentialPointRecordDecompressor::new(&bytes[..]);
        ours.add_field_decompressor(GpsTimes::default());
        let mut theirs = SequentialPointRecordDecompressor::new(&bytes[..]);
        theirs.add_field_decompressor(GpsTimeDecompressor::default());
        for (index, time) in times().into_iter().enumerate() {
            let mut read = [[0; 8]; 2];
            ours.decompress_next(&mut read[0]).unwrap();
            theirs.decompress_next(&mut read[1]).unwrap();
            assert_eq!(read.map(i64::from_le_bytes), [time; 2], "{index}");
        }
    }
}

//! The container: records one after the other, some of them in compressed chunks.
//!
//! Memory is bounded by the largest chunk that is taken. Records that nobody asks for are not kept. A
//! file that ends before its footer, because the robot lost power, is read as far as it goes.

use std::collections::BTreeMap;
use std::io::{self, Read};

pub use mcap::MAGIC;
use mcap::records::{Record, op};

use super::error::McapError;

/// Longest chunk, compressed or not, and longest message outside of chunks, bytes.
const CHUNK_BYTES_MAX: u64 = 64 << 20;
/// A chunk may become this many times its compressed size, …
const RATIO_MAX: u64 = 20;
/// … or this many bytes, if that is more.
const RATIO_FREE_BYTES: u64 = 1 << 20;
/// Memory that a zstd frame may ask for as its window, as a power of two.
const WINDOW_LOG_MAX: u32 = 24;
/// Most topics and most types of a recording; robots have some hundreds.
pub(super) const TOPICS_MAX: usize = 4_096;
/// Opcode and length.
const RECORD_HEAD_BYTES: usize = 9;

/// Longest name of a topic, a type or a frame, bytes.
pub(super) const NAME_BYTES_MAX: usize = 1_024;

/// A topic with its type.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Channel {
    /// The topic.
    pub topic: String,
    /// The name of the messages' type.
    pub schema: String,
    /// How messages are encoded: `cdr`, `json`, …
    pub encoding: String,
}

/// A message of a channel.
pub(super) struct Message<'a> {
    /// Its channel.
    pub channel: &'a Channel,
    /// When it was recorded, nanoseconds since the Unix epoch.
    pub log_time_ns: i64,
    /// As its channel encodes it.
    pub data: &'a [u8],
}

/// Reads the messages of a file in the order in which they were written.
pub(super) struct MessageReader<R> {
    reader: R,
    /// Bytes read so far.
    offset: u64,
    channels: BTreeMap<u16, Channel>,
    schemas: BTreeMap<u16, String>,
    /// The records of the chunk that is read, and where the next of them begins.
    chunk: Vec<u8>,
    chunk_position: usize,
    /// Where the chunk begins in the file.
    chunk_offset: u64,
    /// Whether the file ends within the chunk.
    chunk_is_cut: bool,
    /// Whether there is nothing after the chunk.
    is_done: bool,
    /// Where the file ends without a footer.
    cut_at: Option<u64>,
}

/// What a record says, as far as messages need it.
enum Step {
    /// Nothing.
    Other,
    /// A message: its channel, its time, and where its data begins in the record.
    Message {
        channel_id: u16,
        log_time_ns: i64,
        data_at: usize,
    },
}

impl<R: Read> MessageReader<R> {
    /// A reader at the beginning of a file.
    ///
    /// # Errors
    /// [`McapError::NoMagic`], [`McapError::Io`].
    pub fn new(mut reader: R) -> Result<Self, McapError> {
        let mut magic = [0; MAGIC.len()];
        let read = read_up_to(&mut reader, &mut magic)?;
        if magic[..read] != *MAGIC {
            return Err(McapError::NoMagic);
        }
        Ok(Self {
            reader,
            offset: MAGIC.len() as u64,
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            chunk: Vec::new(),
            chunk_position: 0,
            chunk_offset: 0,
            chunk_is_cut: false,
            is_done: false,
            cut_at: None,
        })
    }

    /// Where the file ended before its footer, if it did; known once there are no more messages.
    pub fn cut_at(&self) -> Option<u64> {
        self.cut_at
    }

    /// The next message whose channel is wanted; `None` at the end.
    ///
    /// # Errors
    /// [`McapError`] with the place of the record that cannot be read.
    pub fn next_message(
        &mut self,
        wanted: impl Fn(&Channel) -> bool,
    ) -> Result<Option<Message<'_>>, McapError> {
        loop {
            while let Some((opcode, body)) = self.next_in_chunk()? {
                let step = self.step(opcode, body.clone(), self.chunk_offset)?;
                if let Step::Message {
                    channel_id,
                    log_time_ns,
                    data_at,
                } = step
                    && self.channels.get(&channel_id).is_some_and(&wanted)
                {
                    return Ok(Some(Message {
                        channel: &self.channels[&channel_id],
                        log_time_ns,
                        data: &self.chunk[body.start + data_at..body.end],
                    }));
                }
            }
            if self.is_done {
                return Ok(None);
            }
            self.read_record()?;
        }
    }

    /// The next record of the chunk: its opcode, and where its body is.
    fn next_in_chunk(&mut self) -> Result<Option<(u8, std::ops::Range<usize>)>, McapError> {
        let rest = &self.chunk[self.chunk_position..];
        if rest.is_empty() {
            return Ok(None);
        }
        let body = rest.get(RECORD_HEAD_BYTES..).and_then(|after| {
            let length = usize::try_from(length_of(rest)).ok()?;
            (length <= after.len()).then_some(length)
        });
        let Some(length) = body else {
            if self.chunk_is_cut {
                self.chunk_position = self.chunk.len();
                return Ok(None);
            }
            let detail = format!(
                "the record at byte {} of the chunk is longer than the chunk",
                self.chunk_position
            );
            return Err(self.damaged(self.chunk_offset, detail));
        };
        let start = self.chunk_position + RECORD_HEAD_BYTES;
        let opcode = rest[0];
        self.chunk_position = start + length;
        Ok(Some((opcode, start..start + length)))
    }

    /// Reads the next record of the file: a chunk, or one that is treated as a chunk of its own.
    fn read_record(&mut self) -> Result<(), McapError> {
        let offset = self.offset;
        let mut head = [0; RECORD_HEAD_BYTES];
        let read = read_up_to(&mut self.reader, &mut head)?;
        self.offset += read as u64;
        if read < head.len() {
            return self.end(Some(offset));
        }
        let (opcode, length) = (head[0], length_of(&head));
        match opcode {
            op::FOOTER | op::DATA_END => self.end(None),
            op::CHUNK => self.read_chunk(offset, length),
            op::SCHEMA | op::CHANNEL | op::MESSAGE if length <= CHUNK_BYTES_MAX => {
                let body = self.read_bytes(length)?;
                if (body.len() as u64) < length {
                    return self.end(Some(offset));
                }
                self.chunk.clear();
                self.chunk.extend_from_slice(&head);
                self.chunk.extend_from_slice(&body);
                self.begin_chunk(offset, false);
                Ok(())
            }
            0 => Err(self.damaged(offset, "no record has the opcode 0".into())),
            _ => {
                let skipped = io::copy(&mut (&mut self.reader).take(length), &mut io::sink())?;
                self.offset += skipped;
                match skipped < length {
                    true => self.end(Some(offset)),
                    false => Ok(()),
                }
            }
        }
    }

    fn end(&mut self, cut_at: Option<u64>) -> Result<(), McapError> {
        self.is_done = true;
        self.cut_at = cut_at;
        Ok(())
    }

    fn read_bytes(&mut self, length: u64) -> Result<Vec<u8>, McapError> {
        let mut bytes = Vec::new();
        (&mut self.reader).take(length).read_to_end(&mut bytes)?;
        self.offset += bytes.len() as u64;
        Ok(bytes)
    }

    fn begin_chunk(&mut self, offset: u64, is_cut: bool) {
        self.chunk_position = 0;
        self.chunk_offset = offset;
        self.chunk_is_cut = is_cut;
    }

    fn read_chunk(&mut self, offset: u64, length: u64) -> Result<(), McapError> {
        if length > CHUNK_BYTES_MAX {
            let detail = format!("it has {length} bytes, more than {CHUNK_BYTES_MAX}");
            return Err(McapError::ChunkTooLarge { offset, detail });
        }
        let body = self.read_bytes(length)?;
        let is_cut = (body.len() as u64) < length;
        let Some(head) = ChunkHead::of(&body) else {
            return match is_cut {
                true => self.end(Some(offset)),
                false => Err(self.damaged(offset, "its head is not whole".into())),
            };
        };
        head.check(offset)?;
        let records_end = (head.records_at as u64).checked_add(head.compressed_bytes);
        let Some(records_end) = records_end else {
            return Err(self.damaged(offset, "its records are longer than any file".into()));
        };
        let end = usize::try_from(records_end)
            .unwrap_or(usize::MAX)
            .min(body.len());
        if !is_cut && records_end > body.len() as u64 {
            return Err(self.damaged(offset, "its records are longer than itself".into()));
        }
        let records = &body[head.records_at..end];
        let (chunk, failure) = head.decompress(records);
        if let Some(failure) = failure.filter(|_| !is_cut) {
            return Err(self.damaged(offset, format!("its records do not decompress: {failure}")));
        }
        if !is_cut {
            head.check_content(&chunk)
                .map_err(|detail| self.damaged(offset, detail))?;
        }
        self.chunk = chunk;
        self.begin_chunk(offset, is_cut);
        if is_cut {
            self.end(Some(offset))?;
        }
        Ok(())
    }

    /// Keeps schemas and channels; says where a message is.
    fn step(
        &mut self,
        opcode: u8,
        body: std::ops::Range<usize>,
        offset: u64,
    ) -> Result<Step, McapError> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(Step::Other);
        }
        let length = body.len();
        let record = mcap::parse_record(opcode, &self.chunk[body]);
        let record = record.map_err(|error| self.damaged(offset, error.to_string()))?;
        match record {
            Record::Schema { header, .. } => {
                self.check_name(&header.name, offset)?;
                let is_known = self.schemas.contains_key(&header.id);
                self.check_count(self.schemas.len(), is_known)?;
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                self.check_name(&channel.topic, offset)?;
                self.check_name(&channel.message_encoding, offset)?;
                let schema = self.schemas.get(&channel.schema_id).cloned();
                let channel_of = Channel {
                    topic: channel.topic,
                    schema: schema.unwrap_or_default(),
                    encoding: channel.message_encoding,
                };
                let known = self.channels.get(&channel.id);
                self.check_count(self.channels.len(), known.is_some())?;
                if known.is_some_and(|known| *known != channel_of) {
                    let detail = format!("it says otherwise of channel {} than before", channel.id);
                    return Err(self.damaged(offset, detail));
                }
                self.channels.insert(channel.id, channel_of);
            }
            Record::Message { header, data } => {
                if !self.channels.contains_key(&header.channel_id) {
                    let detail =
                        format!("a message of channel {}, which is none", header.channel_id);
                    return Err(self.damaged(offset, detail));
                }
                return Ok(Step::Message {
                    channel_id: header.channel_id,
                    log_time_ns: i64::try_from(header.log_time).unwrap_or(i64::MAX),
                    data_at: length - data.len(),
                });
            }
            _ => {}
        }
        Ok(Step::Other)
    }

    fn check_name(&self, name: &str, offset: u64) -> Result<(), McapError> {
        match name.len() {
            0..=NAME_BYTES_MAX => Ok(()),
            length => Err(self.damaged(offset, format!("a name of {length} bytes"))),
        }
    }

    /// Whether there may be one more topic, or one more type.
    fn check_count(&self, count: usize, is_known: bool) -> Result<(), McapError> {
        match is_known || count < TOPICS_MAX {
            true => Ok(()),
            false => Err(McapError::TooManyTopics(TOPICS_MAX)),
        }
    }

    fn damaged(&self, offset: u64, detail: String) -> McapError {
        McapError::Damaged { offset, detail }
    }
}

/// What a chunk says of itself.
struct ChunkHead {
    uncompressed_bytes: u64,
    /// CRC-32 of its records; 0 if it was not computed.
    crc: u32,
    compression: String,
    compressed_bytes: u64,
    /// Where its records begin.
    records_at: usize,
}

impl ChunkHead {
    /// `None` if the bytes end before it does.
    fn of(body: &[u8]) -> Option<Self> {
        let at = |from: usize, bytes: usize| body.get(from..from.checked_add(bytes)?);
        let number = |from: usize| Some(u64::from_le_bytes(at(from, 8)?.try_into().ok()?));
        let short = |from: usize| Some(u32::from_le_bytes(at(from, 4)?.try_into().ok()?));
        let name_at = 32;
        let name_end = usize::try_from(short(28)?).ok()?.checked_add(name_at)?;
        let name = body.get(name_at..name_end)?;
        Some(Self {
            uncompressed_bytes: number(16)?,
            crc: short(24)?,
            compression: String::from_utf8_lossy(name).into_owned(),
            compressed_bytes: number(name_end)?,
            records_at: name_end + 8,
        })
    }

    /// Refuses chunks that would take more memory than their bytes can be worth.
    fn check(&self, offset: u64) -> Result<(), McapError> {
        let by_ratio = self.compressed_bytes.saturating_mul(RATIO_MAX);
        let most = by_ratio.clamp(RATIO_FREE_BYTES, CHUNK_BYTES_MAX);
        if self.uncompressed_bytes <= most {
            return Ok(());
        }
        let detail = format!(
            "its {} bytes become {}: at most {RATIO_MAX} times as many and {CHUNK_BYTES_MAX} are taken",
            self.compressed_bytes, self.uncompressed_bytes
        );
        Err(McapError::ChunkTooLarge { offset, detail })
    }

    /// The records as far as they can be decompressed, and why no farther.
    fn decompress(&self, records: &[u8]) -> (Vec<u8>, Option<io::Error>) {
        let mut bytes = Vec::new();
        let outcome = match self.compression.as_str() {
            "" => self.read(records, &mut bytes),
            "zstd" => zstd::stream::read::Decoder::with_buffer(records).and_then(|mut decoder| {
                decoder.window_log_max(WINDOW_LOG_MAX)?;
                self.read(decoder, &mut bytes)
            }),
            "lz4" => lz4::Decoder::new(records).and_then(|decoder| self.read(decoder, &mut bytes)),
            other => Err(io::Error::other(format!(
                "the compression {other:?} is not known: zstd, lz4 or none"
            ))),
        };
        (bytes, outcome.err())
    }

    /// Reads one byte more than there should be at most, so that a longer chunk is noticed.
    fn read(&self, reader: impl Read, bytes: &mut Vec<u8>) -> io::Result<()> {
        let most = self.uncompressed_bytes + 1;
        reader.take(most).read_to_end(bytes).map(drop)
    }

    fn check_content(&self, chunk: &[u8]) -> Result<(), String> {
        if chunk.len() as u64 != self.uncompressed_bytes {
            return Err(format!(
                "its records are not the {} bytes that it states",
                self.uncompressed_bytes
            ));
        }
        if self.crc != 0 && crc32fast::hash(chunk) != self.crc {
            return Err("its records have another checksum than it states".into());
        }
        Ok(())
    }
}

fn length_of(head: &[u8]) -> u64 {
    let mut length = [0; 8];
    length.copy_from_slice(&head[1..RECORD_HEAD_BYTES]);
    u64::from_le_bytes(length)
}

/// Reads until the buffer is full or the file ends.
fn read_up_to(reader: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match reader.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(read) => filled += read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(filled)
}

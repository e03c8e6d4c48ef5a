//! Why an MCAP recording cannot be used.

use std::io;

use crate::scan::{LidarError, ScanError};

/// Why an MCAP recording cannot be used; the text says what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum McapError {
    /// It could not be read.
    #[error("the recording could not be read")]
    Io(#[from] io::Error),
    /// It is another kind of file.
    #[error("this is no MCAP recording: it does not begin with the bytes \\x89MCAP0\\r\\n")]
    NoMagic,
    /// A record is not what it should be.
    #[error("the record at byte {offset} is damaged: {detail}")]
    Damaged {
        /// Where the record begins in the file.
        offset: u64,
        /// What is wrong with it.
        detail: String,
    },
    /// A chunk takes more memory than is given to it.
    #[error("the chunk at byte {offset} is not taken: {detail}")]
    ChunkTooLarge {
        /// Where the chunk begins in the file.
        offset: u64,
        /// Which limit it exceeds.
        detail: String,
    },
    /// It has more odometry than is kept in memory.
    #[error("the recording has more than {0} odometry messages: cut it into several recordings")]
    TooMuchOdometry(usize),
    /// It has more topics than are kept in memory.
    #[error(
        "the recording has more than {0} topics, or types of messages: record only those that are needed"
    )]
    TooManyTopics(usize),
    /// The topics that are needed are not there, or not the ones asked for.
    #[error("{detail}; {topics}")]
    Topics {
        /// What is missing.
        detail: String,
        /// The topics that there are.
        topics: String,
    },
    /// Where a lidar is mounted cannot be found out.
    #[error("where the lidar of {topic} is mounted is not known: {detail}")]
    Mount {
        /// The topic of its scans.
        topic: String,
        /// What is missing, and what to do.
        detail: String,
    },
    /// A lidar states an impossible geometry.
    #[error("the lidar of {topic} cannot be right")]
    Lidar {
        /// The topic of its scans.
        topic: String,
        /// What is wrong.
        source: LidarError,
    },
    /// A lidar's beams fit no lidar.
    #[error("the scans of {topic} cannot be right")]
    Scan {
        /// The topic of its scans.
        topic: String,
        /// What is wrong.
        source: ScanError,
    },
    /// None of its scans could be used.
    #[error("none of its scans can be used{0}")]
    NoScans(String),
}

//! Why the store could not do it.

use std::fmt;
use std::path::PathBuf;

use crate::ids::{BatchId, EdgeId, NodeId, RouteId};
use crate::model::UnknownText;

/// Why the store could not do it.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The disk is full; nothing was written.
    #[error("the disk is full")]
    Full,
    /// The disk is full, and the schema is not up to date; nothing was written.
    #[error(
        "the disk is full, and the database's schema has to be brought up to date before it can be \
         used: make room on the disk and start again"
    )]
    FullBeforeMigration,
    /// Only the service changes schemas.
    #[error(
        "the database's schema is that of an older version: the service brings it up to date when \
         it starts"
    )]
    OldSchema,
    /// The writer is overloaded, recovering, or shutting down. Whether the write was committed is
    /// unknown only after an I/O error; repeating it is safe.
    #[error("the store does not take writes at the moment")]
    Unavailable,
    /// The route is not there.
    #[error("there is no such route")]
    UnknownRoute,
    /// Another process holds the data directory.
    #[error("the data directory {0} is in use by another process")]
    Locked(PathBuf),
    /// The data directory cannot be used.
    #[error("the data directory {path} cannot be used")]
    Directory {
        /// The directory or the file in it.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The process before this one was lost, and so was its write-ahead log.
    #[error(
        "the last {commits} commits to mapshift.db in {} are lost, acknowledged uploads \
         among them: the process before was not stopped in order, and its log mapshift.db-wal is \
         missing or not whole. Put the log back as it was, or restore a backup: restore --replace, \
         or go on without what is lost: serve --accept-lost-log", directory.display()
    )]
    LostLog {
        /// The data directory.
        directory: PathBuf,
        /// How many commits there were that are not there any more.
        commits: i64,
    },
    /// What is stored is not what was stored; nothing was written.
    #[error("{0} is corrupt on the disk")]
    Corrupt(Corruption),
    /// A job's result contradicts itself or the store; nothing was written.
    #[error("the result does not fit its job: {0}")]
    InvalidResult(String),
    /// A body could not be compressed.
    #[error("the body could not be compressed")]
    Compression(#[source] std::io::Error),
    /// The SQLite that is linked can corrupt a database whose log is reset while it is written.
    #[error("SQLite {0} is too old: 3.51.3 or newer is needed")]
    SqliteTooOld(String),
    /// SQLite did not take a setting that durability rests on.
    #[error("SQLite did not take the setting {name}: it is {found:?}")]
    Setting {
        /// The pragma.
        name: &'static str,
        /// What was read back.
        found: String,
    },
    /// The schema could not be brought up to date.
    #[error("the database's schema could not be brought up to date")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// The database refused a statement.
    #[error("the database refused a statement")]
    Database(#[from] sqlx::Error),
}

impl StoreError {
    /// Whether the same request may be taken later: the disk or the writer is in the way.
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Full | Self::Unavailable)
    }
}

/// What is corrupt.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Corruption {
    /// The body of an upload.
    Body {
        /// Its route.
        route_id: RouteId,
        /// The upload.
        batch_id: BatchId,
    },
    /// The scan of a node.
    Scan {
        /// Its route.
        route_id: RouteId,
        /// The node.
        node_id: NodeId,
    },
    /// What never changes of a node.
    Node(NodeId),
    /// What never changes of an edge.
    Edge(EdgeId),
    /// A value that no version of this program writes.
    Value {
        /// Where it was read.
        column: &'static str,
    },
    /// The text of an enumeration that this version of the program does not know.
    UnknownText {
        /// Where it was read.
        column: &'static str,
        /// The text, and those that are known.
        unknown: UnknownText,
    },
    /// The database file itself, as SQLite says.
    Database,
}

impl fmt::Display for Corruption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Body { route_id, batch_id } => {
                write!(f, "the body of batch {batch_id} of route {route_id}")
            }
            Self::Scan { route_id, node_id } => {
                write!(f, "the scan of node {node_id} of route {route_id}")
            }
            Self::Node(node_id) => write!(f, "node {node_id}"),
            Self::Edge(edge_id) => write!(f, "edge {edge_id}"),
            Self::Value { column } => write!(f, "a value of {column}"),
            Self::UnknownText { column, unknown } => write!(f, "a value of {column} ({unknown})"),
            Self::Database => f.write_str("the database"),
        }
    }
}

/// What an error means for the connection and for the writes that follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Severity {
    /// This write was refused; the connection and the others are sound.
    Write,
    /// This write was refused by the database: the connection is opened anew.
    Statement,
    /// Someone else held the database for too long.
    Busy,
    /// No space: nothing was written, later writes may succeed.
    Full,
    /// The disk or the connection failed: what reached the disk is not known.
    Io,
    /// The file is not a sound database.
    Corrupt,
}

// https://www.sqlite.org/rescode.html: the low byte is the primary code.
const SQLITE_BUSY: i32 = 5;
const SQLITE_LOCKED: i32 = 6;
const SQLITE_NOMEM: i32 = 7;
const SQLITE_READONLY: i32 = 8;
const SQLITE_IOERR: i32 = 10;
const SQLITE_CORRUPT: i32 = 11;
const SQLITE_FULL: i32 = 13;
const SQLITE_CANTOPEN: i32 = 14;
const SQLITE_PROTOCOL: i32 = 15;
const SQLITE_NOTADB: i32 = 26;

impl StoreError {
    /// What this error means for the writes that follow.
    pub(super) fn severity(&self) -> Severity {
        match self {
            Self::Full => Severity::Full,
            Self::Corrupt(Corruption::Database) => Severity::Corrupt,
            Self::Database(error) => database_severity(error),
            Self::Setting { .. } | Self::Directory { .. } | Self::Unavailable => Severity::Io,
            _ => Severity::Write,
        }
    }

    /// The error as callers see it: causes that have a name of their own get it.
    pub(super) fn named(self) -> Self {
        match &self {
            Self::Database(sqlx::Error::PoolClosed | sqlx::Error::PoolTimedOut) => {
                Self::Unavailable
            }
            Self::Database(_) => match self.severity() {
                Severity::Full => Self::Full,
                Severity::Corrupt => Self::Corrupt(Corruption::Database),
                Severity::Busy => Self::Unavailable,
                _ => self,
            },
            _ => self,
        }
    }
}

fn database_severity(error: &sqlx::Error) -> Severity {
    let sqlx::Error::Database(database) = error else {
        return match error {
            sqlx::Error::Io(_) | sqlx::Error::WorkerCrashed | sqlx::Error::BeginFailed => {
                Severity::Io
            }
            _ => Severity::Statement,
        };
    };
    let code = database.code().and_then(|code| code.parse::<i32>().ok());
    match code.map(|code| code & 0xff) {
        Some(SQLITE_FULL) => Severity::Full,
        Some(SQLITE_BUSY | SQLITE_LOCKED) => Severity::Busy,
        Some(SQLITE_CORRUPT | SQLITE_NOTADB) => Severity::Corrupt,
        Some(SQLITE_IOERR | SQLITE_CANTOPEN | SQLITE_READONLY | SQLITE_NOMEM | SQLITE_PROTOCOL)
        | None => Severity::Io,
        Some(_) => Severity::Statement,
    }
}

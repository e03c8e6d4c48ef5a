//! How much of everything the service takes on.

use std::time::Duration;

/// The service's limits. The defaults are for production; tests shorten the times.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Connections open at once; more wait in the kernel's queue.
    pub connections: usize,
    /// Time for a request's head, and for the next request of an idle connection.
    pub header_timeout: Duration,
    /// Time for a request's body.
    pub body_timeout: Duration,
    /// Time for an answer as a whole.
    pub answer_timeout: Duration,
    /// Time for the requests under way when the service is told to stop.
    pub drain_timeout: Duration,
    /// Uploads under way at once.
    pub uploads: usize,
    /// Uploads decoded at once.
    pub decoders: usize,
    /// Bytes of an upload as it is sent.
    pub wire_bytes: usize,
    /// Bytes of an upload after decompression.
    pub body_bytes: usize,
    /// Bytes of all uploads under way as they are sent.
    pub wire_bytes_total: usize,
    /// Bytes of all uploads under way after decompression.
    pub body_bytes_total: usize,
    /// Bytes of any other request's body.
    pub small_body_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 1_024,
            header_timeout: Duration::from_secs(5),
            body_timeout: Duration::from_secs(30),
            answer_timeout: Duration::from_secs(60),
            drain_timeout: Duration::from_secs(10),
            uploads: 32,
            decoders: 2,
            wire_bytes: 16 << 20,
            body_bytes: 64 << 20,
            wire_bytes_total: 64 << 20,
            body_bytes_total: 128 << 20,
            small_body_bytes: 64 << 10,
        }
    }
}

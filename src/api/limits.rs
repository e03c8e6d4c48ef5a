//! The limits of the service.

use std::time::{Duration, Instant};

/// The service's limits. The defaults are for production; tests shorten the times.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Connections open at once. Idle ones are closed to make room for new ones.
    pub connections: usize,
    /// How much of the connections, uploads, bytes of uploads, reads and streams one client address may hold, per
    /// cent. The address is that of the socket: behind a proxy it is the proxy's, regardless of headers.
    pub address_share_percent: u8,
    /// Time for the head of a request, and for the next request on an idle connection.
    pub header_timeout: Duration,
    /// How slowly the body of a request may arrive.
    pub body_pace: Pace,
    /// How slowly a client may read its answer.
    pub answer_pace: Pace,
    /// Time until an answer begins, not counting the body of the request.
    pub answer_timeout: Duration,
    /// How long a read waits for its turn.
    pub turn_timeout: Duration,
    /// Time after which a stream of events ends and its client reconnects.
    pub stream_time: Duration,
    /// Time for requests under way to complete when the service stops.
    pub drain_timeout: Duration,
    /// Uploads under way at once.
    pub uploads: usize,
    /// Reads of a few rows.
    pub short_reads: Reads,
    /// Reads of pictures, series and evidence.
    pub heavy_reads: Reads,
    /// Reads of whole graphs and trajectories, each with a connection of its own to the database.
    pub exports: Reads,
    /// Streams of events open at once; they hold their connections.
    pub streams: usize,
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
    /// Recordings under way at once.
    pub recordings: usize,
    /// Bytes of a recording, and of the batches that it becomes, compressed.
    pub recording_bytes: usize,
    /// Bytes of any other request's body.
    pub small_body_bytes: usize,
}

/// How slowly bytes may be transferred.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// Time before the rate counts.
    pub grace: Duration,
    /// The lowest average rate since the beginning, bytes a second.
    pub bytes_per_s: u32,
    /// Time for the whole transfer.
    pub total: Duration,
}

impl Pace {
    /// When a transfer of which this many bytes have arrived counts as too slow.
    pub fn deadline(&self, begun: Instant, bytes: u64) -> Instant {
        let earned_ms = bytes.saturating_mul(1_000) / u64::from(self.bytes_per_s.max(1));
        let earned = Duration::from_millis(earned_ms);
        begun + self.grace.saturating_add(earned).min(self.total)
    }
}

/// How many reads of a kind are accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reads {
    /// Worked on at once.
    pub at_once: usize,
    /// Waiting, worked on, or not yet sent completely: their answers are in memory.
    pub under_way: usize,
}

impl Limits {
    /// One client address's share of a whole.
    pub fn share(&self, whole: usize) -> usize {
        (whole * usize::from(self.address_share_percent) / 100).max(1)
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 1_024,
            address_share_percent: 50,
            header_timeout: Duration::from_secs(5),
            // Half of the rate of a gateway on a bad radio link.
            body_pace: Pace {
                grace: Duration::from_secs(5),
                bytes_per_s: 1_000,
                total: Duration::from_secs(300),
            },
            answer_pace: Pace {
                grace: Duration::from_secs(20),
                bytes_per_s: 1_000,
                total: Duration::from_secs(600),
            },
            answer_timeout: Duration::from_secs(60),
            turn_timeout: Duration::from_secs(5),
            stream_time: Duration::from_secs(1_800),
            drain_timeout: Duration::from_secs(10),
            uploads: 64,
            short_reads: Reads {
                at_once: 8,
                under_way: 128,
            },
            // The store has three connections for reads: one of them stays free for uploads and
            // short reads.
            heavy_reads: Reads {
                at_once: 2,
                under_way: 16,
            },
            exports: Reads {
                at_once: 4,
                under_way: 8,
            },
            streams: 128,
            decoders: 2,
            wire_bytes: 16 << 20,
            body_bytes: 64 << 20,
            wire_bytes_total: 64 << 20,
            body_bytes_total: 128 << 20,
            recordings: 2,
            recording_bytes: 256 << 20,
            small_body_bytes: 64 << 10,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_gateway_stays_ahead_of_the_deadline_and_a_trickle_does_not() {
        let pace = Limits::default().body_pace;
        let begun = Instant::now();
        let after = |seconds: u64| begun + Duration::from_secs(seconds);
        for seconds in [1, 10, 60, 200] {
            let honest = pace.deadline(begun, 2_000 * seconds);
            assert!(honest > after(seconds), "{seconds} s");
        }
        assert!(pace.deadline(begun, 0) == after(5));
        assert!(pace.deadline(begun, 100 * 6) < after(6));
    }

    #[test]
    fn no_transfer_takes_longer_than_the_total() {
        let pace = Limits::default().body_pace;
        let begun = Instant::now();
        assert_eq!(pace.deadline(begun, u64::MAX), begun + pace.total);
    }

    #[test]
    fn a_share_is_at_least_one() {
        let limits = Limits {
            address_share_percent: 1,
            ..Limits::default()
        };
        assert_eq!((limits.share(1_000), limits.share(3)), (10, 1));
    }
}

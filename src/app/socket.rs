//! A connection's socket: cut off if the client does not read its answer, and without the HTTP library's own refusals.

use std::io::{self, IoSlice};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Instant;

use axum::http::StatusCode;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep_until};

use super::activity::Activity;
use crate::api::Pace;

/// A socket that hyper reads and writes.
pub(super) struct Socket {
    stream: TcpStream,
    activity: Arc<Activity>,
    pace: Pace,
    stall: Option<Stall>,
    end: End,
}

/// How a connection ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// By one of the two sides.
    Ordinary,
    /// Hyper has refused a malformed request head with this status.
    Refusal(StatusCode),
    /// The client does not read its answer.
    Stalled,
}

/// A client that reads its answer too slowly.
struct Stall {
    begun: Instant,
    /// Bytes read since then.
    bytes: u64,
    timer: Pin<Box<Sleep>>,
}

impl Socket {
    pub(super) fn new(stream: TcpStream, activity: Arc<Activity>, pace: Pace) -> Self {
        Self {
            stream,
            activity,
            pace,
            stall: None,
            end: End::Ordinary,
        }
    }

    /// The stream, and how the connection ends.
    pub(super) fn into_parts(self) -> (TcpStream, End) {
        (self.stream, self.end)
    }

    /// Counts the bytes that the client reads, and gives up a client that falls behind the pace.
    fn paced(
        &mut self,
        written: Poll<io::Result<usize>>,
        cx: &mut Context<'_>,
    ) -> Poll<io::Result<usize>> {
        if let (Poll::Ready(Ok(count)), Some(stall)) = (&written, &mut self.stall) {
            stall.bytes += *count as u64;
        }
        if written.is_ready() {
            return written;
        }
        let begun = Instant::now();
        let stall = self.stall.get_or_insert_with(|| Stall {
            begun,
            bytes: 0,
            timer: Box::pin(sleep_until(begun.into())),
        });
        let deadline = self.pace.deadline(stall.begun, stall.bytes).into();
        if stall.timer.deadline() != deadline {
            stall.timer.as_mut().reset(deadline);
        }
        match stall.timer.as_mut().poll(cx) {
            Poll::Pending => Poll::Pending,
            Poll::Ready(()) => {
                self.end = End::Stalled;
                metrics::counter!("mapshift_stalled_clients_total").increment(1);
                let problem = "the client does not read its answer";
                Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, problem)))
            }
        }
    }

    /// While no request is being answered, hyper can only write its refusal of a malformed head: a status without a body.
    /// It is held back, and a problem is sent instead.
    fn keep_refusal(&mut self, bytes: &[u8]) {
        let status = bytes
            .strip_prefix(b"HTTP/1.1 ")
            .and_then(|rest| rest.get(..3));
        let status = status.and_then(|digits| StatusCode::from_bytes(digits).ok());
        if let Some(status) = status {
            self.end = End::Refusal(status);
        }
    }
}

impl AsyncRead for Socket {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Socket {
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        self.poll_write_vectored(cx, &[IoSlice::new(bytes)])
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        if self.activity.idle_since().is_some() {
            self.keep_refusal(slices.first().map_or(&[], |first| first));
            let length = slices.iter().map(|slice| slice.len()).sum();
            return Poll::Ready(Ok(length));
        }
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, slices);
        self.paced(written, cx)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    /// Hyper flushes once it has written everything.
    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stall = None;
        self.activity.sent();
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    /// The connection's task closes the stream itself.
    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

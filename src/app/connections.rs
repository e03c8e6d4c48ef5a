//! The listener: bounded connections with time limits, and their orderly shutdown.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::answering::Answering;
use super::places::{NoPlace, Place, Places};
use super::socket::{End, Socket};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::{Limits, Quota, raw_answer};

/// Pause after the system refuses a connection, for example because file descriptors have run out.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// Connections that may wait in the kernel to be accepted.
const BACKLOG: u32 = 1_024;
/// How much the kernel buffers of an answer that the client does not read, and hyper of requests and answers besides the
/// piece that it is writing.
const SEND_BUFFER_BYTES: u32 = 256 << 10;
const BUFFER_BYTES: usize = 64 << 10;
/// The longest request line and headers.
const HEAD_BYTES_MAX: usize = 32 << 10;
/// For how long, and how many bytes, a closed connection is read until its end.
const LINGER: Duration = Duration::from_secs(1);
const LINGER_BYTES: usize = 16 << 20;
/// Connections that are refused with an answer at the same time; others are closed without one.
const REFUSALS_AT_ONCE: usize = 128;
/// Time for clients that connected during the shutdown to read their refusal.
const LATE_CONNECTIONS_TIMEOUT: Duration = Duration::from_millis(500);

/// Listens on an address, with bounded buffers for answers that clients do not read.
pub(super) fn listen(address: SocketAddr) -> std::io::Result<TcpListener> {
    let socket = match address {
        SocketAddr::V4(_) => TcpSocket::new_v4()?,
        SocketAddr::V6(_) => TcpSocket::new_v6()?,
    };
    socket.set_reuseaddr(true)?;
    // Accepted connections inherit it.
    socket.set_send_buffer_size(SEND_BUFFER_BYTES)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Serves one router on many connections.
pub(super) struct Connections {
    router: TowerToHyperService<Router>,
    limits: Limits,
    places: Arc<Places>,
    draining: CancellationToken,
}

impl Connections {
    pub(super) fn new(router: Router, limits: Limits, draining: CancellationToken) -> Self {
        Self {
            router: TowerToHyperService::new(router),
            places: Arc::new(Places::new(&limits)),
            limits,
            draining,
        }
    }

    /// Accepts connections until the service drains and the requests of earlier connections are answered. Clients that
    /// connect in the meantime are refused.
    pub(super) async fn serve(self, listener: TcpListener) {
        let (mut early, mut late) = (JoinSet::new(), JoinSet::new());
        let mut refused = JoinSet::new();
        let never = CancellationToken::new();
        loop {
            let drained = self.draining.is_cancelled();
            // Checked before the first connection too: the service may be stopped at once.
            if drained && early.is_empty() {
                break;
            }
            tokio::select! {
                () = self.draining.cancelled(), if !drained => {}
                accepted = accept(&listener) => {
                    let Some((stream, peer)) = accepted else { continue };
                    let end = if drained { never.clone() } else { self.draining.clone() };
                    let set = if drained { &mut late } else { &mut early };
                    match self.places.take(peer.into()) {
                        Ok(place) => { set.spawn(self.serve_one(stream, peer, place, end)); }
                        Err(why) if refused.len() < REFUSALS_AT_ONCE => {
                            refused.spawn(end_with(stream, self.no_place(why)));
                        }
                        Err(why) => drop(self.no_place(why)),
                    }
                }
                ended = early.join_next(), if !early.is_empty() => {
                    if let Some(Err(error)) = ended {
                        tracing::error!(%error, "a connection's task failed");
                    }
                }
            }
            metrics::gauge!("mapshift_connections").set(early.len() as f64);
            while late.try_join_next().is_some() {}
            while refused.try_join_next().is_some() {}
        }
        drop(listener);
        let rest = async { while late.join_next().await.is_some() {} };
        let _ = tokio::time::timeout(LATE_CONNECTIONS_TIMEOUT, rest).await;
    }

    /// The problem of a connection for which there is no place.
    fn no_place(&self, why: NoPlace) -> Problem {
        let (scope, problem) = match why {
            NoPlace::OfAddress => {
                let quota = Quota::requests("connections", self.places.per_address());
                ("address", quota.exceeded())
            }
            NoPlace::AtAll => {
                let detail = "all connections are in use; connect again later";
                ("service", Problem::new(ProblemKind::Overloaded, detail))
            }
        };
        metrics::counter!("mapshift_limit_refusals_total", "limit" => "connections", "scope" => scope)
            .increment(1);
        problem
    }

    /// Serves a connection to its end; once `end` is cancelled, its current request is its last.
    fn serve_one(
        &self,
        stream: TcpStream,
        peer: IpAddr,
        place: Place,
        end: CancellationToken,
    ) -> impl Future<Output = ()> + 'static {
        let service = Answering {
            router: self.router.clone(),
            peer,
            activity: place.activity.clone(),
        };
        let mut http = http1::Builder::new();
        http.timer(TokioTimer::new())
            .header_read_timeout(self.limits.header_timeout)
            .max_header_size(HEAD_BYTES_MAX)
            .max_buf_size(BUFFER_BYTES);
        let pace = self.limits.answer_pace;
        async move {
            let _ = stream.set_nodelay(true);
            let mut socket = Socket::new(stream, place.activity.clone(), pace);
            {
                let connection = http.serve_connection(TokioIo::new(&mut socket), service);
                tokio::pin!(connection);
                let outcome = tokio::select! {
                    outcome = connection.as_mut() => outcome,
                    () = end.cancelled() => {
                        connection.as_mut().graceful_shutdown();
                        connection.await
                    }
                    () = place.activity.unwanted.cancelled() => {
                        if place.activity.idle_since().is_some() {
                            return;
                        }
                        // Its next request has just arrived: it is answered as the last one.
                        connection.as_mut().graceful_shutdown();
                        connection.await
                    }
                };
                if let Err(error) = outcome {
                    tracing::debug!(%error, "a connection ended early");
                }
            }
            let (stream, how) = socket.into_parts();
            match how {
                End::Ordinary => linger(stream).await,
                End::Refusal(status) => {
                    let status_text = status.as_u16().to_string();
                    metrics::counter!("mapshift_http_requests_total", "method" => "other", "path" => "unmatched", "status" => status_text)
                        .increment(1);
                    end_with(stream, Problem::from_status(status)).await;
                }
                // Discards what the kernel still buffers for it.
                End::Stalled => drop(stream.set_zero_linger()),
            }
        }
    }
}

async fn accept(listener: &TcpListener) -> Option<(TcpStream, IpAddr)> {
    match listener.accept().await {
        Ok((stream, peer)) => Some((stream, peer.ip())),
        Err(error) => {
            tracing::warn!(%error, "a connection was not accepted");
            tokio::time::sleep(ACCEPT_PAUSE).await;
            None
        }
    }
}

/// Sends a problem that is not the answer to a request, and closes the connection.
async fn end_with(mut stream: TcpStream, problem: Problem) {
    let answer = raw_answer(&problem);
    // A few hundred bytes fit into the kernel's buffer in any case.
    let written = tokio::time::timeout(LINGER, stream.write_all(&answer)).await;
    if matches!(written, Ok(Ok(()))) {
        linger(stream).await;
    }
}

/// Reads what a client still sends after its answer. Closing at once would reset the connection, and the client would
/// lose a refusal that it has not read yet.
async fn linger(mut stream: TcpStream) {
    let _ = stream.shutdown().await;
    let drain = async {
        let mut rest = vec![0; 16 << 10];
        let mut read = 0;
        while read < LINGER_BYTES {
            match stream.read(&mut rest).await {
                Ok(0) | Err(_) => break,
                Ok(count) => read += count,
            }
        }
    };
    let _ = tokio::time::timeout(LINGER, drain).await;
}

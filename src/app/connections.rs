//! The listener: bounded connections with time limits, and their orderly end.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::api::Limits;

/// Pause after the system refuses a connection, e.g. for want of file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);
/// How long, and for how many bytes, a closed connection is read to its end.
const LINGER: Duration = Duration::from_secs(1);
const LINGER_BYTES: usize = 16 << 20;
/// How long those who came while the service was draining have to read its refusal.
const LATE_CONNECTIONS_TIMEOUT: Duration = Duration::from_millis(500);

/// Serves one router on many connections.
pub(super) struct Connections {
    service: TowerToHyperService<Router>,
    limits: Limits,
    places: Arc<Semaphore>,
    draining: CancellationToken,
}

impl Connections {
    pub(super) fn new(router: Router, limits: Limits, draining: CancellationToken) -> Self {
        Self {
            service: TowerToHyperService::new(router),
            places: Arc::new(Semaphore::new(limits.connections)),
            limits,
            draining,
        }
    }

    /// Accepts connections until the service drains, then until the requests of the earlier
    /// connections are answered: who comes in between is told to come back later.
    pub(super) async fn serve(self, listener: TcpListener) {
        let (mut early, mut late) = (JoinSet::new(), JoinSet::new());
        let never = CancellationToken::new();
        loop {
            let drained = self.draining.is_cancelled();
            tokio::select! {
                () = self.draining.cancelled(), if !drained => {}
                stream = self.accept(&listener) => {
                    let Some((stream, place)) = stream else { continue };
                    let end = if drained { never.clone() } else { self.draining.clone() };
                    let task = self.serve_one(stream, end);
                    let set = if drained { &mut late } else { &mut early };
                    set.spawn(async move {
                        task.await;
                        drop(place);
                    });
                }
                ended = early.join_next(), if !early.is_empty() => {
                    if let Some(Err(error)) = ended {
                        tracing::error!(%error, "a connection's task failed");
                    }
                }
            }
            if self.draining.is_cancelled() && early.is_empty() {
                break;
            }
            metrics::gauge!("mapshift_connections").set(early.len() as f64);
            while late.try_join_next().is_some() {}
        }
        drop(listener);
        let rest = async { while late.join_next().await.is_some() {} };
        let _ = tokio::time::timeout(LATE_CONNECTIONS_TIMEOUT, rest).await;
    }

    async fn accept(
        &self,
        listener: &TcpListener,
    ) -> Option<(TcpStream, tokio::sync::OwnedSemaphorePermit)> {
        let place = self.places.clone().acquire_owned().await.ok()?;
        match listener.accept().await {
            Ok((stream, _)) => Some((stream, place)),
            Err(error) => {
                tracing::warn!(%error, "a connection was not accepted");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                None
            }
        }
    }

    /// Serves a connection to its end; once `end` is cancelled, its current request is its last.
    fn serve_one(
        &self,
        mut stream: TcpStream,
        end: CancellationToken,
    ) -> impl Future<Output = ()> + 'static {
        let service = self.service.clone();
        let header_timeout = self.limits.header_timeout;
        async move {
            let _ = stream.set_nodelay(true);
            {
                let mut http = http1::Builder::new();
                http.timer(TokioTimer::new())
                    .header_read_timeout(header_timeout);
                let connection = http.serve_connection(TokioIo::new(&mut stream), service);
                tokio::pin!(connection);
                let outcome = tokio::select! {
                    outcome = connection.as_mut() => outcome,
                    () = end.cancelled() => {
                        connection.as_mut().graceful_shutdown();
                        connection.await
                    }
                };
                if let Err(error) = outcome {
                    tracing::debug!(%error, "a connection ended early");
                }
            }
            linger(stream).await;
        }
    }
}

/// Reads what a client still sends after its answer. Closing at once would reset the connection,
/// and the client would lose an early refusal that it had not read yet.
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

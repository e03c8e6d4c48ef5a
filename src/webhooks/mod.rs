//! Webhooks: events sent to whoever asked for them, signed, until they are taken.
//!
//! Knows the store, which queues a delivery in the transaction of the change that it is about
//! (`store/webhook_deliveries.rs`, `store/notices.rs`); knows nothing of how changes come about. An event
//! arrives at least once: its row is pending until an attempt has been noted. How alerts, batches, vehicles
//! and operations are written is the interface's affair and handed in ([`Forms`]).
//!
//! Whatever is sent is the alert as it is then. So an update that a receiver knows already is
//! dropped, and of those that a receiver does not take, all but the newest of each alert
//! (`store/webhook_attempts.rs`).
//!
//! Whoever registers a webhook makes the service open connections. [`ReceiverPolicy`] says where
//! to; it is asked when a URL is registered, before each attempt, and for every address that a
//! name resolves to (`resolver.rs`). Redirects are not followed, proxies of the environment not
//! used, and of an answer only its status and `Retry-After` are read.
//!
//! Begin with [`start`].

mod address;
mod dispatcher;
mod message;
mod resolver;
mod retention;
mod schedule;
mod sender;
mod signature;
mod url_check;

pub use address::ReceiverPolicy;
pub use message::Forms;
pub use signature::{generate_secret, secret_text};
pub use url_check::{URL_LENGTH_MAX, UrlRefusal};

use std::sync::Arc;
use std::time::Duration;

use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::store::Store;
use dispatcher::Dispatcher;
use sender::Sender;

/// How webhooks are called.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeliveryOptions {
    /// Where receivers may live.
    pub policy: ReceiverPolicy,
    /// Time for an attempt, from the look-up of the name to the head of the answer.
    pub timeout: Duration,
    /// Pauses after the first, second … attempt that failed; after one more it is given up.
    pub pauses: Vec<Duration>,
}

impl Default for DeliveryOptions {
    fn default() -> Self {
        Self {
            policy: ReceiverPolicy::default(),
            timeout: Duration::from_secs(15),
            pauses: schedule::PAUSES.to_vec(),
        }
    }
}

/// Why webhooks cannot be called.
#[derive(Debug, thiserror::Error)]
#[error("no HTTP client can be had")]
pub struct DeliveryError(#[from] reqwest::Error);

/// Starts the tasks that call webhooks on the current runtime. They end soon after `stopping` is
/// cancelled; what is cut off is sent again at the next start.
///
/// # Errors
/// [`DeliveryError`] if no HTTP client can be had.
pub fn start(
    store: &Store,
    options: DeliveryOptions,
    forms: Arc<dyn Forms>,
    stopping: &CancellationToken,
) -> Result<Vec<JoinHandle<()>>, DeliveryError> {
    let dispatcher = Dispatcher {
        store: store.clone(),
        sender: Sender::new(options.policy, options.timeout)?,
        forms,
        pauses: options.pauses,
    };
    Ok(vec![
        tokio::spawn(dispatcher.run(stopping.clone())),
        tokio::spawn(retention::delete_old(store.clone(), stopping.clone())),
    ])
}

//! The log of one test among others that run beside it.

use std::sync::Once;

use tracing::Subscriber;
use tracing::subscriber::{DefaultGuard, set_default, set_global_default};

static EVERY_CALLSITE_IS_ON: Once = Once::new();

/// Sends what this thread logs to a subscriber until the guard is dropped.
///
/// Threads of other tests have none. While there is only one subscriber, a place in the code that such a thread
/// logs from first is taken to interest nobody, for all threads: the global one, which keeps nothing, prevents
/// that.
pub fn log_to(subscriber: impl Subscriber + Send + Sync + 'static) -> DefaultGuard {
    EVERY_CALLSITE_IS_ON.call_once(|| {
        set_global_default(tracing_subscriber::registry()).unwrap();
    });
    set_default(subscriber)
}

//! Who may send which request: identities, roles, and the layer that enforces them for every operation.
//!
//! The table of operations is in `operations`, the layers are in `guard`. A handler whose answer depends on the sender
//! takes an [`Identity`]; one that changes something takes an `Actor`.

mod authenticate;
mod cookie;
mod guard;
mod hosts;
mod identity;
mod operations;
mod proxies;
mod security;
mod sign_ins;

pub(super) use authenticate::not_a_key;
pub(super) use cookie::{ended_cookie, session_cookie, session_id};
pub(super) use guard::{Rules, admit, check_origin};
pub(super) use hosts::Hosts;
pub use hosts::{InvalidUrl, PublicUrl};
pub(super) use identity::Identity;
pub use proxies::{GroupRole, InvalidGroupRole, InvalidNetwork, Network, TrustedProxies};
pub(super) use security::add_security;
pub(super) use sign_ins::SignIns;

/// The names of the service, and the proxies that are trusted to identify people.
#[derive(Debug, Clone, Default)]
pub struct AccessOptions {
    /// The URL under which people reach the service, if that is not the address that it listens on.
    pub public_url: Option<PublicUrl>,
    /// The proxies that are trusted to identify people.
    pub proxies: TrustedProxies,
}

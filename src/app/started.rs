//! The line that the log begins with.

use std::net::SocketAddr;

use crate::api::Limits;
use crate::config::AppConfig;
use crate::pipeline::PipelineOptions;
use crate::store::schema_version;
use crate::webhooks::ReceiverPolicy;

/// Says what was started: program, schema, data, address, who may, and which settings are not the usual
/// ones.
pub(super) fn report(config: &AppConfig, listen: SocketAddr, has_keys: bool) {
    tracing::info!(
        version = env!("CARGO_PKG_VERSION"),
        schema = schema_version(),
        data = %config.data_dir.display(),
        %listen,
        access = access(config, has_keys),
        settings = unusual(config).join(" "),
        "the service has started"
    );
}

/// Who may: whoever has a key, whom a proxy has signed in, or everybody.
fn access(config: &AppConfig, has_keys: bool) -> &'static str {
    match (has_keys, config.access.proxies.networks.is_empty()) {
        (true, _) => "keys",
        (false, false) => "proxy",
        (false, true) => "open",
    }
}

/// The settings that differ from the defaults, by the names of their flags.
fn unusual(config: &AppConfig) -> Vec<String> {
    let (limits, usual) = (&config.limits, Limits::default());
    let (kept, usual_kept) = (&config.pipeline, PipelineOptions::default());
    let mut settings = Vec::new();
    let mut note = |is_unusual: bool, text: String| {
        if is_unusual {
            settings.push(text);
        }
    };
    let share = limits.address_share_percent;
    note(
        share != usual.address_share_percent,
        format!("address-share={share}"),
    );
    note(
        kept.map_memory_bytes != usual_kept.map_memory_bytes,
        format!("map-memory-mb={}", kept.map_memory_bytes >> 20),
    );
    if let Some(time) = kept.keep_bodies {
        let days = time.as_secs() / (24 * 60 * 60);
        note(true, format!("keep-bodies-days={days}"));
    }
    if let Some(time) = kept.keep_trajectories {
        let days = time.as_secs() / (24 * 60 * 60);
        note(true, format!("trajectory-retention-days={days}"));
    }
    if let Some(url) = &config.access.public_url {
        note(true, format!("public-url={}", url.origin()));
    }
    let proxies = &config.access.proxies;
    for network in &proxies.networks {
        note(true, format!("trusted-proxy={network}"));
    }
    for role in &proxies.roles {
        note(true, format!("proxy-role={role}"));
    }
    note(config.accept_lost_log, "accept-lost-log".to_owned());
    note(
        config.insecure_open_to_network,
        "insecure-open-to-network".to_owned(),
    );
    let to_private = config.delivery.policy == ReceiverPolicy::PrivateToo;
    note(to_private, "webhooks-to-private-networks".to_owned());
    settings
}

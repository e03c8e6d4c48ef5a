//! The first line of the log.

use std::net::SocketAddr;

use crate::api::Limits;
use crate::config::AppConfig;
use crate::pipeline::PipelineOptions;
use crate::store::schema_version;
use crate::webhooks::ReceiverPolicy;

/// Logs what was started: version, schema, data directory, address, who has access, and the settings that differ from
/// the defaults.
pub(super) fn report(config: &AppConfig, listen: SocketAddr, has_keys: bool) {
    tracing::info!(
        version = env!("CARGO_PKG_VERSION"),
        schema = schema_version(),
        data = %config.data_dir.display(),
        %listen,
        access = access(config, has_keys),
        settings = changed_settings(config).join(" "),
        "the service has started"
    );
}

/// Who has access: holders of keys, people whom a proxy has signed in, or everybody.
fn access(config: &AppConfig, has_keys: bool) -> &'static str {
    match (has_keys, config.access.proxies.networks.is_empty()) {
        (true, _) => "keys",
        (false, false) => "proxy",
        (false, true) => "open",
    }
}

/// The settings that differ from the defaults, by the names of their flags.
fn changed_settings(config: &AppConfig) -> Vec<String> {
    let (limits, default) = (&config.limits, Limits::default());
    let (pipeline, default_pipeline) = (&config.pipeline, PipelineOptions::default());
    let mut settings = Vec::new();
    let mut note = |is_changed: bool, text: String| {
        if is_changed {
            settings.push(text);
        }
    };
    let share = limits.address_share_percent;
    note(
        share != default.address_share_percent,
        format!("address-share={share}"),
    );
    note(
        pipeline.map_memory_bytes != default_pipeline.map_memory_bytes,
        format!("map-memory-mb={}", pipeline.map_memory_bytes >> 20),
    );
    if let Some(time) = pipeline.keep_bodies {
        let days = time.as_secs() / (24 * 60 * 60);
        note(true, format!("keep-bodies-days={days}"));
    }
    if let Some(time) = pipeline.keep_trajectories {
        let days = time.as_secs() / (24 * 60 * 60);
        note(true, format!("trajectory-retention-days={days}"));
    }
    if let Some(time) = pipeline.keep_names {
        let days = time.as_secs() / (24 * 60 * 60);
        note(true, format!("name-retention-days={days}"));
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

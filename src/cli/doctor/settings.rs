//! Settings that are dangerous unless intended.

use super::finding::Finding;
use crate::config::ServiceArgs;

const CHECK: &str = "settings";
/// With fewer days a map cannot be rebuilt after a fault that is noticed late.
const KEEP_DAYS_MIN: u32 = 30;

/// Checks the settings that the service would have.
pub(super) fn check(settings: &ServiceArgs) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut warn = |finding: String, advice: &str| {
        findings.push(Finding::warning(CHECK, finding, advice));
    };
    if settings.insecure_open_to_network {
        warn(
            "insecure-open-to-network: without a key, anyone who reaches it may upload and delete"
                .to_owned(),
            "make keys (mapshift keys create) and take the setting away",
        );
    }
    if settings.webhooks_to_private_networks {
        warn(
            "webhooks-to-private-networks: who registers webhooks can call machines of the plant"
                .to_owned(),
            "leave it only if receivers live there, and give role admin to few",
        );
    }
    if settings
        .trusted_proxies
        .iter()
        .any(|proxy| proxy.is_everybody())
    {
        warn(
            "trusted-proxy names every address: anyone can say who they are".to_owned(),
            "name the proxy's own address",
        );
    }
    if let Some(days) = settings
        .keep_bodies_days
        .filter(|days| *days < KEEP_DAYS_MIN)
    {
        warn(
            format!(
                "keep-bodies-days {days}: maps can be made anew only from bodies that are kept"
            ),
            "keep them longer if the disk allows, or back up more often",
        );
    }
    match findings.is_empty() {
        true => vec![Finding::ok(CHECK, "none is dangerous")],
        false => findings,
    }
}

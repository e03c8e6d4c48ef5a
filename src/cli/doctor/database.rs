//! The database: schema, log, clock, and what waits or was refused in it.

use jiff::{SignedDuration, Timestamp};

use super::finding::Finding;
use crate::api;
use crate::store::{Checkup, Contents, SchemaAge};

/// Stamps this far ahead are a wrong clock, not a small offset.
const AHEAD_MAX: SignedDuration = SignedDuration::from_secs(60);
const WAIT_MAX: SignedDuration = SignedDuration::from_hours(1);
/// The service cuts its log at 64 MiB.
const LOG_BYTES_MAX: u64 = 256 << 20;
const MEBIBYTE: u64 = 1 << 20;

/// Checks the schema.
pub(super) fn schema(contents: &Contents) -> Finding {
    let check = "schema";
    let schema = format!("version {}", contents.schema);
    match contents.schema_age() {
        SchemaAge::Same => Finding::ok(check, schema),
        SchemaAge::Older => Finding::warning(
            check,
            format!("{schema}, that of an earlier release: the rest of it is not checked"),
            "back up, then start the service, which brings it up to date",
        ),
        SchemaAge::Newer => Finding::error(
            check,
            format!("{schema}, that of a later release"),
            "use that release, or restore a backup of before the upgrade",
        ),
    }
}

/// Checks the rest.
pub(super) fn check(checkup: &Checkup, now: Timestamp) -> Vec<Finding> {
    let mut findings = vec![log(checkup), clock(checkup, now)];
    findings.extend(quarantined(checkup));
    findings.extend(waiting(checkup, now));
    findings.extend(vehicles(checkup));
    findings.extend(webhooks(checkup));
    findings
}

fn log(checkup: &Checkup) -> Finding {
    let check = "write-ahead log";
    if checkup.lost_commits > 0 {
        return Finding::error(
            check,
            format!("the last {} commits are lost with it", checkup.lost_commits),
            "put mapshift.db-wal back as it was, or restore a backup; `serve --accept-lost-log` goes on without",
        );
    }
    let size = format!("{} MiB", checkup.log_bytes / MEBIBYTE);
    match checkup.log_bytes > LOG_BYTES_MAX {
        true => Finding::warning(
            check,
            size,
            "end whatever reads the database for long (backup, fsck --full, sqlite3): the log cannot be cut meanwhile",
        ),
        false => Finding::ok(check, size),
    }
}

fn clock(checkup: &Checkup, now: Timestamp) -> Finding {
    let check = "clock";
    match checkup.newest_write_at {
        Some(newest) if newest.duration_since(now) > AHEAD_MAX => Finding::error(
            check,
            format!("the database has stamps of {newest:.0}, and it is {now:.0}"),
            "set the machine's clock (timedatectl): trips, retries and keys go by it",
        ),
        _ => Finding::ok(check, "not behind what is stored"),
    }
}

fn quarantined(checkup: &Checkup) -> Vec<Finding> {
    let check = "quarantined batches";
    if checkup.quarantined.is_empty() {
        return vec![Finding::ok(check, "none")];
    }
    let advice =
        "of the last week; see what the reason says; POST …/batches/{batch}/retry tries one again";
    let finding = |(reason, count): &(String, u64)| {
        Finding::warning(check, format!("{count}: {reason}"), advice)
    };
    checkup.quarantined.iter().map(finding).collect()
}

fn waiting(checkup: &Checkup, now: Timestamp) -> Vec<Finding> {
    let is_late =
        |since: Option<Timestamp>| since.is_some_and(|since| now.duration_since(since) > WAIT_MAX);
    let (queued, held) = (checkup.queued, checkup.held);
    let text = |count, since: Option<Timestamp>| match since {
        Some(since) => format!("{count}, the oldest of {since:.0}"),
        None => "none".to_owned(),
    };
    let queue = text(queued.batches, queued.oldest_at);
    let gaps = text(held.batches, held.oldest_at);
    vec![
        match is_late(queued.oldest_at) {
            true => Finding::warning(
                "queue",
                queue,
                "see whether the service runs and is ready; if it does, its workers do not keep up",
            ),
            false => Finding::ok("queue", queue),
        },
        match is_late(held.oldest_at) {
            true => Finding::warning(
                "held batches",
                gaps,
                "their predecessors have not arrived: does a gateway still keep them?",
            ),
            false => Finding::ok("held batches", gaps),
        },
        match checkup.unanchored {
            0 => Finding::ok("batches not localised", "none"),
            count => Finding::warning(
                "batches not localised",
                count.to_string(),
                "give the trip's first batch an initial_pose, or drive a part of the way that is mapped",
            ),
        },
    ]
}

fn vehicles(checkup: &Checkup) -> Vec<Finding> {
    let check = "vehicles";
    if checkup.suspects.is_empty() {
        return vec![Finding::ok(check, "none is suspect")];
    }
    let findings = checkup.suspects.iter().map(|alert| {
        let vehicles: Vec<&str> = alert.vehicles.iter().map(|id| id.as_str()).collect();
        let (vehicles, route) = (vehicles.join(", "), &alert.route_id);
        let finding = format!("{vehicles} on route {route}: {}", summary(alert.clone()));
        let advice = "check the vehicle, or correct its stated mount; then dismiss the alert";
        Finding::warning(check, finding, advice)
    });
    findings.collect()
}

/// What the interface says of an alert in a sentence.
fn summary(alert: crate::store::AlertRecord) -> String {
    let id = alert.id;
    let text = api::alert_text(alert).unwrap_or_default();
    let body: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let summary = body.get("summary").and_then(|summary| summary.as_str());
    summary.map_or_else(|| format!("alert {id}"), str::to_owned)
}

/// Scheme, host and port of a URL.
fn host_of(url: &str) -> String {
    let without_query = url.split(['?', '#']).next().unwrap_or_default();
    let parts: Vec<&str> = without_query.split('/').take(3).collect();
    parts.join("/")
}

fn webhooks(checkup: &Checkup) -> Vec<Finding> {
    let check = "webhooks";
    if checkup.webhooks.is_empty() {
        return vec![Finding::ok(check, "none fails")];
    }
    let findings = checkup.webhooks.iter().map(|webhook| {
        // Without path and query, which may contain a token.
        let (id, host) = (&webhook.id, host_of(&webhook.url));
        match webhook.gone {
            true => Finding::warning(
                check,
                format!("{id} to {host} said that it is gone, and gets nothing any more"),
                format!("delete the webhook {id}, or enable it again"),
            ),
            false => Finding::warning(
                check,
                format!(
                    "{id} to {host}: {} events given up, {} tried again",
                    webhook.failed, webhook.pending
                ),
                format!("GET /v1/webhooks/{id}/deliveries says how its attempts ended"),
            ),
        }
    });
    findings.collect()
}

#[cfg(test)]
mod tests {
    use super::super::finding::Level;
    use super::*;
    use crate::store::{Backlog, FailingWebhook};

    fn checkup() -> Checkup {
        let none = Backlog {
            batches: 0,
            oldest_at: None,
        };
        Checkup {
            quarantined: Vec::new(),
            held: none,
            queued: none,
            unanchored: 0,
            suspects: Vec::new(),
            webhooks: Vec::new(),
            newest_write_at: None,
            body_bytes: 0,
            recent_body_bytes: 0,
            first_batch_at: None,
            log_bytes: 0,
            file_bytes: 0,
            lost_commits: 0,
        }
    }

    #[test]
    fn what_is_wrong_is_named_and_nothing_else() {
        let now: Timestamp = "2026-11-20T06:00:00Z".parse().unwrap();
        let faults = |checkup: &Checkup| -> Vec<(&str, Level)> {
            let findings = check(checkup, now).into_iter();
            let faults = findings.filter(|finding| finding.level != Level::Ok);
            faults
                .map(|finding| (finding.check, finding.level))
                .collect()
        };
        assert_eq!(faults(&checkup()), []);
        let mut sick = checkup();
        sick.newest_write_at = Some("2026-11-20T07:00:00Z".parse().unwrap());
        sick.quarantined = vec![("two vehicles in one trip".to_owned(), 3)];
        sick.held = Backlog {
            batches: 1,
            oldest_at: Some("2026-11-20T04:00:00Z".parse().unwrap()),
        };
        sick.queued = Backlog {
            batches: 1,
            oldest_at: Some("2026-11-20T05:59:00Z".parse().unwrap()),
        };
        sick.webhooks = vec![FailingWebhook {
            id: "w".to_owned(),
            url: "https://example.com".to_owned(),
            failed: 2,
            pending: 0,
            gone: false,
        }];
        sick.lost_commits = 5;
        let expected = [
            ("write-ahead log", Level::Error),
            ("clock", Level::Error),
            ("quarantined batches", Level::Warning),
            ("held batches", Level::Warning),
            ("webhooks", Level::Warning),
        ];
        assert_eq!(faults(&sick), expected);
    }
}

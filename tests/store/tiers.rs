//! Alerts that are tentative at first, what is kept of them, and whom they are sent to.
//!
//! With SQL past the store, for SQLite: what the table itself refuses, and the statements of a migration.

use mapshift::change::{
    AlertStatus, ChangeKind, Counterpart, Finding, JudgedPass, JudgedPasses, Tier,
};
use mapshift::geometry::Vector2;
use mapshift::ids::{AlertId, NodeId, StampNs, TripId, VehicleId, WebhookId, ZoneId};
use mapshift::model::{
    BatchStatus, Clearance, PassOutcome, PassSide, WebhookEvent, WebhookTopic, ZonePurpose,
};
use mapshift::store::{
    AlertFilter, AlertRecord, Applied, Handling, HistoryEntry, NewWebhook, Registered, SYSTEM,
    Store, StoreError, Subject, WebhookSecret, WebhookUpdate, ZoneEdit, ZoneMade,
};
use uuid::Uuid;

use crate::support::{Fixture, at, by, route, upload};

const PLAIN: u128 = 1;
const WITH_TENTATIVE: u128 = 2;

pub async fn register(store: &Store, number: u128, include_tentative: bool) {
    let webhook = NewWebhook {
        id: WebhookId(Uuid::from_u128(number)),
        url: "https://example.com/".to_owned(),
        secret: WebhookSecret([7; 32]),
        events: WebhookTopic::DEFAULT.to_vec(),
        route_id: None,
        description: None,
        include_tentative,
        created_at: at(0),
    };
    let registered = store.register_webhook(webhook, by()).await.unwrap();
    assert_eq!(registered, Registered::Created);
}

pub fn alert(number: u128, tier: Tier) -> AlertRecord {
    let corners = [[0.0, 0.0], [0.1 + 0.2, 0.0], [0.3, 1.0 / 3.0]];
    AlertRecord {
        id: AlertId(Uuid::from_u128(number)),
        route_id: route(),
        revision: 1,
        decision_revision: 1,
        decision_region: corners.map(Vector2::from).to_vec(),
        status: AlertStatus::Open,
        evidence: Finding {
            kind: ChangeKind::Appeared,
            location: Vector2::new(0.2, 0.1),
            sigma_m: 0.05,
            region: corners.map(Vector2::from).to_vec(),
            tier,
            counterpart: None,
            shift: None,
            suspect: None,
            bands: Vec::new(),
            edges: Vec::new(),
            nodes: vec![NodeId(1)],
            trips: vec![TripId::new("t").unwrap()],
            views: 1,
            laps: 1,
            confidence: 0.9,
            since: StampNs(1_000),
            last_seen: StampNs(2_000),
            until: None,
        },
        first_seen: StampNs(1_000),
        vehicles: vec![VehicleId::new("v").unwrap()],
        passes: Some(passes()),
        clearance: Some(Clearance::Near),
        residual: None,
        map_version: 1,
        related: Vec::new(),
        raised_at: at(1),
        updated_at: at(1),
        handling: Handling::default(),
        history: vec![HistoryEntry {
            status: AlertStatus::Open,
            at: at(1),
            by: SYSTEM.to_owned(),
            note: None,
            reason: None,
        }],
    }
}

fn passes() -> JudgedPasses {
    let pass = |second: i64, side, outcome| JudgedPass {
        trip: TripId::new("t").unwrap(),
        vehicle: VehicleId::new("v").unwrap(),
        begins: StampNs(second),
        ends: StampNs(second + 1),
        side,
        outcome,
        node: NodeId(1),
    };
    let passes = vec![
        pass(500, PassSide::Before, PassOutcome::OldState),
        pass(1_000, PassSide::Since, PassOutcome::NewState),
    ];
    JudgedPasses::of(ChangeKind::Appeared, passes)
}

pub fn next(alert: &AlertRecord, tier: Tier) -> AlertRecord {
    let mut next = alert.clone();
    next.revision += 1;
    next.decision_revision += i64::from(tier != alert.evidence.tier);
    next.evidence.tier = tier;
    next
}

/// Round the alerts, for a while.
pub fn mute() -> ZoneEdit {
    ZoneEdit {
        polygon: [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
            .map(Vector2::from)
            .to_vec(),
        purpose: ZonePurpose::Mute,
        kinds: None,
        until: Some(at(100)),
        note: None,
    }
}

/// A batch whose job writes the alert.
pub async fn write(fixture: &Fixture, batch: &str, alert: &AlertRecord) -> Result<(), StoreError> {
    fixture.journal(upload(batch, batch, 0)).await;
    let job = fixture.claim(0).await.unwrap();
    let mut result = fixture.result(&job, BatchStatus::Merged).await;
    result.alerts = vec![alert.clone()];
    let applied = fixture.store.apply_result(result).await?;
    assert_eq!(applied, Applied::Committed);
    Ok(())
}

/// What a webhook is sent, the oldest first.
async fn sent(store: &Store, webhook: u128) -> Vec<(u128, WebhookTopic)> {
    let webhook = WebhookId(Uuid::from_u128(webhook));
    let mut sent = store.deliveries(webhook, None, 100).await.unwrap();
    sent.reverse();
    let sent = sent.iter().map(|one| match (&one.subject, one.event) {
        (Some(Subject::Alert(id)), WebhookEvent::Topic(topic)) => (id.0.as_u128(), topic),
        other => panic!("{other:?}"),
    });
    sent.collect()
}

#[tokio::test]
async fn tier_and_counterpart_are_read_back_to_the_bit() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let mut first = alert(1, Tier::Tentative);
    first.evidence.counterpart = Some(Counterpart {
        kind: ChangeKind::Disappeared,
        region: vec![Vector2::new(1.0 / 7.0, -0.0), Vector2::new(1e-300, 5.0)],
    });
    write(&fixture, "b0", &first).await.unwrap();
    let second = next(&alert(2, Tier::Confirmed), Tier::Confirmed);
    write(&fixture, "b1", &alert(2, Tier::Confirmed))
        .await
        .unwrap();
    write(&fixture, "b2", &second).await.unwrap();
    for expected in [&first, &second] {
        let read = store.alert(expected.id).await.unwrap();
        assert_eq!(read.as_ref(), Some(expected));
    }
    for (tier, expected) in [(Tier::Tentative, &first), (Tier::Confirmed, &second)] {
        let filter = AlertFilter {
            tier: Some(tier),
            ..AlertFilter::default()
        };
        let page = store.alert_page(&filter, None, 9).await.unwrap();
        assert_eq!(page, std::slice::from_ref(expected));
    }
    let mut without = next(&first, Tier::Confirmed);
    without.evidence.counterpart = None;
    write(&fixture, "b3", &without).await.unwrap();
    assert_eq!(store.alert(first.id).await.unwrap(), Some(without));

    let mut broken = alert(3, Tier::Tentative);
    broken.evidence.counterpart = Some(Counterpart {
        kind: ChangeKind::Disappeared,
        region: vec![Vector2::new(f64::NAN, 0.0)],
    });
    let refused = write(&fixture, "b4", &broken).await;
    assert!(matches!(refused, Err(StoreError::InvalidResult(_))));
}

#[tokio::test]
async fn a_shift_is_read_back_to_the_bit() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    let mut shifted = alert(1, Tier::Tentative);
    shifted.evidence.kind = ChangeKind::MapMismatch;
    shifted.evidence.shift = Some(Vector2::new(0.1 + 0.2, -1.0 / 3.0));
    write(&fixture, "b0", &shifted).await.unwrap();
    assert_eq!(
        store.alert(shifted.id).await.unwrap(),
        Some(shifted.clone())
    );
    let mut other = next(&shifted, Tier::Tentative);
    other.evidence.shift = Some(Vector2::new(1e-300, -0.0));
    write(&fixture, "b1", &other).await.unwrap();
    assert_eq!(store.alert(other.id).await.unwrap(), Some(other.clone()));
    let mut without = next(&other, Tier::Tentative);
    without.evidence.shift = None;
    write(&fixture, "b2", &without).await.unwrap();
    assert_eq!(store.alert(without.id).await.unwrap(), Some(without));

    let mut broken = alert(2, Tier::Tentative);
    broken.evidence.shift = Some(Vector2::new(f64::NAN, 0.0));
    let refused = write(&fixture, "b3", &broken).await;
    assert!(matches!(refused, Err(StoreError::InvalidResult(_))));
    // Half a shift is refused by the table itself.
    let mut raw = fixture.raw().await;
    let half = sqlx::query("UPDATE alerts SET shift_x = 0.5").execute(&mut raw);
    assert!(half.await.is_err());
}

#[tokio::test]
async fn a_webhook_hears_of_an_alert_when_it_is_confirmed_or_asks_for_more() {
    use WebhookTopic::{AlertRaised as Raised, AlertUpdated as Updated};
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, PLAIN, false).await;
    register(store, WITH_TENTATIVE, true).await;

    let raised = alert(1, Tier::Tentative);
    write(&fixture, "b0", &raised).await.unwrap();
    let seen_again = next(&raised, Tier::Tentative);
    write(&fixture, "b1", &seen_again).await.unwrap();
    assert_eq!(sent(store, PLAIN).await, []);
    assert_eq!(sent(store, WITH_TENTATIVE).await, [(1, Raised)]);

    // Confirmed, less certain again, and confirmed once more: it begins once.
    let mut now = seen_again;
    for (batch, tier) in [
        ("b2", Tier::Confirmed),
        ("b3", Tier::Tentative),
        ("b4", Tier::Confirmed),
    ] {
        now = next(&now, tier);
        write(&fixture, batch, &now).await.unwrap();
        // More of the same is nothing to decide about.
        now = next(&now, tier);
        let again = format!("{batch}-again");
        write(&fixture, &again, &now).await.unwrap();
    }
    let updated = [(1, Updated), (1, Updated)];
    let plain = sent(store, PLAIN).await;
    assert_eq!((plain[0], &plain[1..]), ((1, Raised), &updated[..]));
    assert_eq!(sent(store, WITH_TENTATIVE).await.len(), 4);

    // One that is raised confirmed is the same to both.
    write(&fixture, "b5", &alert(2, Tier::Confirmed))
        .await
        .unwrap();
    for webhook in [PLAIN, WITH_TENTATIVE] {
        let last = sent(store, webhook).await.last().copied();
        assert_eq!(last, Some((2, Raised)));
    }
    // Whoever asks for tentative ones is sent them from then on.
    let update = WebhookUpdate {
        include_tentative: Some(true),
        ..WebhookUpdate::default()
    };
    let id = WebhookId(Uuid::from_u128(PLAIN));
    store
        .update_webhook(id, None, update, by(), at(5))
        .await
        .unwrap();
    write(&fixture, "b6", &alert(3, Tier::Tentative))
        .await
        .unwrap();
    for webhook in [PLAIN, WITH_TENTATIVE] {
        let last = sent(store, webhook).await.last().copied();
        assert_eq!(last, Some((3, Raised)));
    }
    // Streams have all of it.
    let events = store.alert_events(None, 0, 100).await.unwrap();
    assert_eq!(events.len(), 10);
    let decisions = events.iter().filter(|event| event.is_decision);
    assert_eq!(decisions.count(), 6);
}

#[tokio::test]
async fn what_was_raised_before_there_were_tiers_is_confirmed() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, PLAIN, false).await;
    let first = alert(1, Tier::Tentative);
    write(&fixture, "b0", &first).await.unwrap();
    // As the file of the migration leaves a row that was there.
    let migration = include_str!("../../migrations/0008_alert_tiers.sql");
    let update = migration
        .split_inclusive(';')
        .find(|sql| sql.contains("UPDATE alerts"));
    let mut raw = fixture.raw().await;
    sqlx::query(update.unwrap())
        .execute(&mut raw)
        .await
        .unwrap();
    sqlx::query("UPDATE alerts SET tier = 'confirmed'")
        .execute(&mut raw)
        .await
        .unwrap();
    write(&fixture, "b1", &next(&first, Tier::Confirmed))
        .await
        .unwrap();
    assert_eq!(sent(store, PLAIN).await, [(1, WebhookTopic::AlertUpdated)]);
}

/// What is withheld while a zone mutes an alert is made good when the zone is over, and nothing twice.
#[tokio::test]
async fn a_webhook_is_sent_what_it_missed_once_a_zone_is_over() {
    use WebhookTopic::{AlertRaised as Raised, AlertUpdated as Updated};
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, PLAIN, false).await;
    register(store, WITH_TENTATIVE, true).await;
    let zone = ZoneId(Uuid::from_u128(7));
    let made = store.create_zone(&route(), zone, mute(), by(), at(0)).await;
    assert_eq!(made.unwrap(), ZoneMade::Created);
    let raised = alert(1, Tier::Tentative);
    write(&fixture, "b0", &raised).await.unwrap();
    let confirmed = next(&raised, Tier::Confirmed);
    write(&fixture, "b1", &confirmed).await.unwrap();
    let open = async || {
        let record = store.route(&route()).await.unwrap();
        record.unwrap().counts.open_alerts
    };
    assert_eq!(
        (sent(store, PLAIN).await, sent(store, WITH_TENTATIVE).await),
        (vec![], vec![])
    );
    assert_eq!(
        (open().await, store.end_zones(at(99)).await.unwrap()),
        (0, 0)
    );
    assert_eq!(store.end_zones(at(100)).await.unwrap(), 1);
    assert_eq!(store.end_zones(at(101)).await.unwrap(), 0);
    assert_eq!(open().await, 1);
    for webhook in [PLAIN, WITH_TENTATIVE] {
        assert_eq!(sent(store, webhook).await, [(1, Raised)]);
    }
    let grown = next(&confirmed, Tier::Confirmed);
    write(&fixture, "b2", &grown).await.unwrap();
    let comment = store.comment_on_alert(raised.id, "kim".into(), "hm".into(), by(), at(102));
    assert!(comment.await.unwrap().is_some());
    for webhook in [PLAIN, WITH_TENTATIVE] {
        assert_eq!(sent(store, webhook).await, [(1, Raised)]);
    }
    write(&fixture, "b3", &next(&grown, Tier::Tentative))
        .await
        .unwrap();
    for webhook in [PLAIN, WITH_TENTATIVE] {
        assert_eq!(sent(store, webhook).await, [(1, Raised), (1, Updated)]);
    }
}

/// A zone under which an alert only gains evidence leaves nothing to make good.
#[tokio::test]
async fn nothing_is_sent_when_a_zone_ends_under_which_nothing_was_decided_about() {
    let fixture = Fixture::new().await;
    let store = &fixture.store;
    register(store, WITH_TENTATIVE, true).await;
    let raised = alert(1, Tier::Tentative);
    write(&fixture, "b0", &raised).await.unwrap();
    let (route, zone) = (route(), ZoneId(Uuid::from_u128(7)));
    let made = store.create_zone(&route, zone, mute(), by(), at(0));
    assert_eq!(made.await.unwrap(), ZoneMade::Created);
    let grown = next(&raised, Tier::Tentative);
    write(&fixture, "b1", &grown).await.unwrap();
    assert_eq!(store.end_zones(at(100)).await.unwrap(), 1);
    let begun = [(1, WebhookTopic::AlertRaised)];
    assert_eq!(sent(store, WITH_TENTATIVE).await, begun);
}

//! SIGKILL at any moment costs nothing that was acknowledged.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use mapshift::store::fsck;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use tempfile::TempDir;
use tokio::sync::Notify;

use crate::client::{Client, Put};
use crate::drives::{Batch, interleaved, two_vehicles};
use crate::process::Process;
use crate::state::State;

fn uploads() -> Vec<Batch> {
    let drives = two_vehicles(120);
    interleaved(&drives.map(|drive| drive.batches(12)))
}

#[tokio::test(flavor = "multi_thread")]
async fn five_kills_leave_no_trace() {
    kills_leave_no_trace(5, 3).await;
}

/// `cargo test --test service -- --ignored fifty_kills`
#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes half a minute"]
async fn fifty_kills_leave_no_trace() {
    for seed in 0..10 {
        kills_leave_no_trace(5, seed).await;
    }
}

async fn kills_leave_no_trace(kills: usize, seed: u64) {
    let uploads = uploads();
    let undisturbed = undisturbed(&uploads).await;
    let directory = TempDir::new().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut acknowledged = BTreeSet::new();
    let mut in_the_midst = 0;
    for _ in 0..kills {
        let mut process = Process::start(directory.path());
        let client = Client::new(&process.url);
        client.put_route("line", Value::Null).await;
        in_the_midst += usize::from(has_work(&client).await);
        nothing_is_lost(&client, &acknowledged).await;
        // Not by the clock alone: on a fast machine everything would be done before the kill.
        let enough = acknowledged.len() + rng.random_range(1..4);
        let wait = Duration::from_millis(rng.random_range(0..20));
        let progress = Arc::new(Notify::new());
        let sending = send_until_cut_off(client, uploads.clone(), enough, progress.clone());
        let sending = tokio::spawn(sending);
        progress.notified().await;
        tokio::time::sleep(wait).await;
        process.kill();
        acknowledged.extend(sending.await.unwrap());
    }

    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    client.put_route("line", Value::Null).await;
    in_the_midst += usize::from(has_work(&client).await);
    nothing_is_lost(&client, &acknowledged).await;
    assert!(in_the_midst > 0, "the kills came too late to show anything");
    eprintln!("seed {seed}: {in_the_midst} of {kills} kills left work behind");
    client.put_all("line", &uploads).await;
    let batches = client.merged("line").await;
    assert_eq!(batches.len(), uploads.len());
    let state = State::of(&client, "line").await;
    assert!(
        state == undisturbed,
        "{:?}",
        state.distance_to(&undisturbed)
    );
    for batch in &uploads {
        assert_eq!(client.put("line", batch).await, Put::Replayed);
    }
    assert!(State::of(&client, "line").await == undisturbed);
    let report = fsck(directory.path(), true, &|_, _| {}).await.unwrap();
    assert!(report.sound, "{:?}", report.faults);
}

async fn has_work(client: &Client) -> bool {
    client.route("line").await["pending_batches"] != 0
}

async fn undisturbed(uploads: &[Batch]) -> State {
    let directory = TempDir::new().unwrap();
    let process = Process::start(directory.path());
    let client = Client::new(&process.url);
    client.put_route("line", Value::Null).await;
    client.put_all("line", uploads).await;
    client.merged("line").await;
    State::of(&client, "line").await
}

async fn nothing_is_lost(client: &Client, acknowledged: &BTreeSet<String>) {
    for id in acknowledged {
        let batch = client.batch("line", id).await;
        assert_ne!(batch["status"], "quarantined", "{batch}");
    }
}

/// Sends everything from the start, as a gateway does that has forgotten where it was, and says
/// when enough is acknowledged; hands back what was.
async fn send_until_cut_off(
    client: Client,
    uploads: Vec<Batch>,
    enough: usize,
    progress: Arc<Notify>,
) -> Vec<String> {
    let mut acknowledged = Vec::new();
    for batch in &uploads {
        match client.try_put("line", batch).await {
            Ok(_) => acknowledged.push(batch.id.clone()),
            Err(_) => break,
        }
        if acknowledged.len() == enough {
            progress.notify_one();
        }
    }
    progress.notify_one();
    acknowledged
}

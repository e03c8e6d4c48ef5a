//! SIGKILL at any moment costs nothing that was acknowledged.
//!
//! Every life of the service has two routes of its own, which two gateways fill at once until it is
//! killed: so each kill meets uploads and jobs, and no job meets more than one kill. One that does
//! waits, longer each time, and is given up after four (`store/jobs.rs`); that is another promise.

use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use tempfile::TempDir;
use tokio::sync::Notify;

use crate::client::Client;
use crate::drives::{Batch, interleaved, two_vehicles};
use crate::gateway::{Acknowledged, Gateway};
use crate::oracle;
use crate::process::Process;
use crate::ready;
use crate::row::{Finding, Form, Row, nothing_in_the_way, run};
use crate::state::State;

pub const ROW: Row = Row {
    name: "kill",
    shows: "SIGKILL under upload: nothing acknowledged is lost, nothing is there twice, soon ready",
    obstacle: nothing_in_the_way,
    run: |form| run(kill(form)),
};

/// Kills that one data directory outlives.
const KILLS_EACH: usize = 25;
const READY_WITHIN: Duration = Duration::from_secs(1);

/// What was seen of all lives.
#[derive(Default)]
struct Seen {
    ready_after: Vec<Duration>,
    acknowledged: usize,
    /// Routes that had work left in the end.
    with_work: usize,
    faults: Vec<String>,
}

async fn kill(form: Form) -> Finding {
    let kills = form.choose(8, 1_000_usize);
    let uploads = interleaved(&two_vehicles(24).map(|drive| drive.batches(2)));
    let undisturbed = undisturbed(&uploads).await;
    let mut seen = Seen::default();
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for done in (0..kills).step_by(KILLS_EACH) {
        let lives = KILLS_EACH.min(kills - done);
        outlive(lives, &uploads, &undisturbed, &mut rng, &mut seen).await;
        if form == Form::Full {
            eprintln!("{} kills, {} faults", done + lives, seen.faults.len());
        }
    }
    let mut finding = Finding {
        faults: seen.faults,
        control: control(&uploads).await,
        ..Finding::default()
    };
    seen.ready_after.sort_unstable();
    let (median, worst) = (seen.ready_after[kills / 2], seen.ready_after[kills - 1]);
    finding.figure(format!(
        "{kills} kills, {} of {} routes with work left; {} batches acknowledged before them; ready \
         again after {} ms (median), {} ms (worst)",
        seen.with_work,
        2 * kills,
        seen.acknowledged,
        median.as_millis(),
        worst.as_millis()
    ));
    finding.expect(seen.with_work > 0, || {
        "the kills came too late to show anything".to_owned()
    });
    finding.expect(form == Form::Quick || worst < READY_WITHIN, || {
        format!("it was ready again only after {worst:?}")
    });
    finding
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

/// Lives of one data directory, each ended by a kill, and what is there after the last.
async fn outlive(
    lives: usize,
    uploads: &[Batch],
    undisturbed: &State,
    rng: &mut ChaCha8Rng,
    seen: &mut Seen,
) {
    let directory = TempDir::new().unwrap();
    let mut acknowledged = Acknowledged::default();
    for life in 0..lives {
        let (mut process, ready_after) = ready::start(directory.path()).await.unwrap();
        seen.ready_after.push(ready_after);
        seen.faults
            .extend(oracle::lost(&process.url, &acknowledged).await);
        let enough = rng.random_range(1..uploads.len());
        let wait = Duration::from_millis(rng.random_range(0..20));
        let routes = routes_of(life);
        let (progress, client) = (Arc::new(Notify::new()), Client::new(&process.url));
        let mut sending = Vec::new();
        for route in routes.clone() {
            client.put_route(&route, Value::Null).await;
            let gateway = Gateway::new(&process.url);
            let sends =
                send_until_cut_off(gateway, route, uploads.to_vec(), enough, progress.clone());
            sending.push(tokio::spawn(sends));
        }
        progress.notified().await;
        tokio::time::sleep(wait).await;
        process.kill();
        for sends in sending {
            let (of_route, faults) = sends.await.unwrap();
            seen.acknowledged += of_route.len();
            acknowledged.note_all(of_route);
            seen.faults.extend(faults);
        }
    }
    let (process, _) = ready::start(directory.path()).await.unwrap();
    for route in (0..lives).flat_map(routes_of) {
        let client = Client::new(&process.url);
        client.put_route(&route, Value::Null).await;
        let pending = client.route(&route).await["pending_batches"]
            .as_i64()
            .unwrap();
        seen.with_work += usize::from(pending > 0);
        client.put_all(&route, uploads).await;
        uploads
            .iter()
            .for_each(|batch| acknowledged.note(&route, batch));
    }
    for route in (0..lives).flat_map(routes_of) {
        let client = Client::new(&process.url);
        client.settled(&route, true).await;
        if State::of(&client, &route).await != *undisturbed {
            seen.faults.push(format!(
                "the map of {route} is not what it is without a kill"
            ));
        }
    }
    seen.faults
        .extend(oracle::faults(&process.url, directory.path(), &acknowledged).await);
}

fn routes_of(life: usize) -> [String; 2] {
    [format!("east-{life}"), format!("west-{life}")]
}

/// Sends until the connection breaks, and says when enough is acknowledged; hands back what was.
async fn send_until_cut_off(
    gateway: Gateway,
    route: String,
    uploads: Vec<Batch>,
    enough: usize,
    progress: Arc<Notify>,
) -> (Acknowledged, Vec<String>) {
    let (mut acknowledged, mut faults) = (Acknowledged::default(), Vec::new());
    for (sent, batch) in uploads.iter().enumerate() {
        match gateway.put(&route, batch).await {
            Ok(answer) if answer.status == 202 => acknowledged.note(&route, batch),
            Ok(answer) => faults.push(format!("{} got {answer:?}", batch.id)),
            Err(_) => break,
        }
        if sent + 1 == enough {
            progress.notify_one();
        }
    }
    progress.notify_one();
    (acknowledged, faults)
}

/// What is found after the write-ahead log of a killed service was deleted.
pub async fn control(uploads: &[Batch]) -> Vec<String> {
    let directory = TempDir::new().unwrap();
    let mut acknowledged = Acknowledged::default();
    let mut process = Process::start(directory.path());
    Client::new(&process.url)
        .put_route("line", Value::Null)
        .await;
    let gateway = Gateway::new(&process.url);
    for batch in uploads {
        if gateway
            .put("line", batch)
            .await
            .unwrap()
            .is_acknowledgement()
        {
            acknowledged.note("line", batch);
        }
    }
    process.kill();
    for ending in ["-wal", "-shm"] {
        std::fs::remove_file(directory.path().join(format!("mapshift.db{ending}"))).unwrap();
    }
    let mut command: Command = Process::command(directory.path());
    command.args(["--listen", "127.0.0.1:0", "--accept-lost-log"]);
    let process = Process::started(command).expect("a lost log is accepted");
    oracle::faults(&process.url, directory.path(), &acknowledged).await
}

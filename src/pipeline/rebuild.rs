//! Makes a route's map anew without everything that was removed from it, as if that had never come: the
//! journal is repeated in a copy of the route while the service goes on, and the map that comes of it is put
//! in the place of the present one.

mod silence;

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use anyhow::bail;
use futures::FutureExt;
use futures::future::BoxFuture;
use jiff::Timestamp;

use super::engine::{Engine, is_passing, now};
use super::options::PipelineOptions;
use super::rebuilt_alerts::rebuilt_alerts;
use super::repeat::{Manner, Repeat, Replayed, is_whole};
use super::workspace::Workspace;
use crate::geometry::Vector2;
use crate::ids::{BatchId, OperationId, RouteId, StampNs, TripId};
use crate::model::AlertStatus;
use crate::store::{Adoption, InputsToRepeat, RemovalResult, Store, StoreOptions};
pub(super) use silence::hushed;
use silence::silently;

/// As long as more inputs than these have come meanwhile, they are repeated while the route goes on, …
const INPUTS_LEFT_MAX: u64 = 4;
/// … but not more often than this: uploads may come faster than they are repeated.
const ROUNDS_MAX: usize = 32;
/// How often it is tried to put the map in its place: somebody may change a setting meanwhile, and the store
/// may be busy.
const ADOPTIONS_MAX: usize = 16;
/// Between two tries.
const PAUSE: Duration = Duration::from_secs(1);
/// As often as this a map is begun to be made anew, by one removal: the process may be lost meanwhile.
const BEGUN_MAX: i64 = 4;

/// What learns how much is done, from 0 to 1; its error ends the work.
pub(super) type OnShare = Box<dyn Fn(f64) -> anyhow::Result<()> + Send + Sync>;

/// A map that is to be made anew.
pub(super) struct Rebuild {
    pub engine: Engine,
    pub route: RouteId,
    /// The removal that asked for it.
    pub operation: OperationId,
    /// What was removed, for the result.
    pub removed: RemovalResult,
    /// When it happened, where a journal is repeated; `None` if it happens now.
    pub once: Option<Once>,
}

/// When a map was made anew.
#[derive(Clone, Copy)]
pub(super) struct Once {
    /// The key of the input that says so; later ones are none of it.
    pub key: i64,
    /// The time that its result is stamped with.
    pub at: Timestamp,
}

impl Rebuild {
    /// Makes the map anew and puts it in the place of the present one.
    ///
    /// # Errors
    /// If the journal cannot be repeated; the map is left as it is then.
    pub fn carry_out(self, on_share: OnShare) -> BoxFuture<'static, anyhow::Result<()>> {
        // What happens in the copy is no news: it has happened before.
        silently(|| self.make_and_adopt(on_share)).boxed()
    }

    async fn make_and_adopt(self, on_share: OnShare) -> anyhow::Result<()> {
        let store = &self.engine.store;
        if self.once.is_none() {
            self.check_before().await?;
        }
        let removed = store.removed_batches(&self.route).await?;
        let (left_out, trips): (BTreeSet<BatchId>, BTreeSet<TripId>) = removed.into_iter().unzip();
        let directory = store.copy_directory()?;
        let data_dir = directory.path().to_path_buf();
        let copy = Store::open(StoreOptions { data_dir }).await?;
        let inputs = store.inputs_to_repeat(&self.route).await?;
        store.copy_route(&self.route, &copy).await?;
        copy.begin_rebuild(&self.route).await?;
        let options = PipelineOptions {
            keep_bodies: None,
            keep_trajectories: None,
            ..self.engine.options
        };
        let engine = Engine::of_one_thread(&copy, options)?;
        let mut repeat = Repeat::new(engine, store, &self.route, Manner::Without(&left_out));
        match self.once {
            Some(Once { key, .. }) => {
                repeat.repeat_until(key, |_| Ok(())).await?;
                if !self.adopt(&copy, &repeat.engine).await? {
                    bail!("somebody else writes to the copy");
                }
            }
            None => {
                self.catch_up(&copy, &mut repeat, inputs, &on_share).await?;
                self.put_in_place(&copy, &mut repeat, &trips, &on_share)
                    .await?;
            }
        }
        drop(repeat);
        Ok(copy.close().await?)
    }

    /// # Errors
    /// If the map cannot be made anew: something that shaped it is not kept, or there is no room, or it was
    /// tried too often.
    async fn check_before(&self) -> anyhow::Result<()> {
        let store = &self.engine.store;
        if !is_whole(store, &self.route).await? {
            bail!("its journal begins after its first batches, which an earlier version processed");
        }
        let missing = store.merged_without_body(&self.route).await?;
        if missing > 0 {
            bail!("the bodies of {missing} other batches in its map are not kept any more");
        }
        if store.begin_rebuilding(self.operation).await? > BEGUN_MAX {
            bail!("the process was lost {BEGUN_MAX} times while the route was processed again");
        }
        if !store.has_room_for_copy(&self.route).await? {
            bail!("there is no room on the disk for a copy of the route");
        }
        Ok(())
    }

    /// Repeats the inputs that there are, and those that come meanwhile, until few are left.
    async fn catch_up(
        &self,
        copy: &Store,
        repeat: &mut Repeat<'_>,
        mut inputs: InputsToRepeat,
        on_share: &OnShare,
    ) -> anyhow::Result<()> {
        for _ in 0..ROUNDS_MAX {
            let count = inputs.count.max(1) as f64;
            let repeated = repeat.repeat_until(inputs.last, |done| on_share(done as f64 / count));
            repeated.await?;
            inputs = self.copy_more(copy).await?;
            if inputs.count <= repeat.replayed.inputs + INPUTS_LEFT_MAX {
                return Ok(());
            }
        }
        bail!("uploads come faster than they can be processed again")
    }

    /// Repeats what is left, while nothing else is computed for the route, and puts the map in its place.
    async fn put_in_place(
        &self,
        copy: &Store,
        repeat: &mut Repeat<'_>,
        removed_trips: &BTreeSet<TripId>,
        on_share: &OnShare,
    ) -> anyhow::Result<()> {
        let _turn = self.engine.turn(&self.route).await;
        for _ in 0..ADOPTIONS_MAX {
            let inputs = self.copy_more(copy).await?;
            repeat.repeat_until(inputs.last, |_| on_share(1.0)).await?;
            self.check_decisions(&repeat.replayed, removed_trips)
                .await?;
            match self.adopt(copy, &repeat.engine).await {
                Ok(true) => return Ok(()),
                Ok(false) => {}
                Err(error) if is_passing(&error) => {}
                Err(error) => return Err(error),
            }
            on_share(1.0)?;
            tokio::time::sleep(PAUSE).await;
        }
        bail!("the route kept changing while its map was made anew")
    }

    /// Looks for decisions that could not be repeated although what they are about did not rest on what was
    /// removed alone: they would be lost.
    async fn check_decisions(
        &self,
        replayed: &Replayed,
        removed_trips: &BTreeSet<TripId>,
    ) -> anyhow::Result<()> {
        let store = &self.engine.store;
        for &id in &replayed.decisions_left_out {
            let Some(alert) = store.alert(id).await? else {
                continue;
            };
            let is_decided =
                [AlertStatus::Accepted, AlertStatus::Dismissed].contains(&alert.status);
            let rests_on_others = alert
                .evidence
                .trips
                .iter()
                .any(|t| !removed_trips.contains(t));
            if is_decided && rests_on_others {
                bail!("the decision about alert {id} would be lost");
            }
        }
        Ok(())
    }

    /// Copies into a store what has come meanwhile.
    async fn copy_more(&self, store: &Store) -> anyhow::Result<InputsToRepeat> {
        let present = &self.engine.store;
        // Before their batches are copied, so that none of them is missing.
        let inputs = present.inputs_to_repeat(&self.route).await?;
        present.copy_route(&self.route, store).await?;
        store.go_on_with_rebuild(&self.route).await?;
        Ok(inputs)
    }

    /// Puts what was made in a copy in the place of the present map; false if the route has changed meanwhile.
    async fn adopt(&self, copy: &Store, engine: &Engine) -> anyhow::Result<bool> {
        let made = engine.workspaces.take(copy, &self.route).await?;
        let Engine {
            store, workspaces, ..
        } = &self.engine;
        let present = workspaces.take(store, &self.route).await?;
        let at = self.once.map_or_else(now, |once| once.at);
        let alerts = rebuilt_alerts(&present.alerts, &made.alerts, at);
        let adoption = Adoption {
            operation: self.operation,
            route_id: self.route.clone(),
            base_revision: present.revision,
            made_in: copy.database_path().to_path_buf(),
            is_whole: self.once.is_none(),
            result: RemovalResult {
                alerts: self.removed.alerts.max(alerts.len() as u64),
                moved_m: self.removed.moved_m + farthest_m(&present, &made),
                rebuilt: true,
                ..self.removed.clone()
            },
            alerts,
            at,
        };
        Ok(store.adopt(adoption).await?)
    }
}

/// The largest distance between the places of a scan in two maps, metres.
fn farthest_m(before: &Workspace, after: &Workspace) -> f64 {
    let before: BTreeMap<_, _> = places(before).collect();
    let moved = places(after).filter_map(|(scan, place)| Some((before.get(&scan)? - place).norm()));
    moved.fold(0.0, f64::max)
}

fn places(workspace: &Workspace) -> impl Iterator<Item = ((&TripId, StampNs), Vector2<f64>)> {
    let keyframes = workspace.map.keyframes().iter();
    let nodes = keyframes.zip(workspace.map.graph().nodes());
    nodes.map(|(keyframe, node)| {
        let scan = (&keyframe.trip, keyframe.stamp);
        (scan, node.pose.translation())
    })
}

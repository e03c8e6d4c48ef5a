//! What becomes of a route's alerts while vehicles drive.

use std::collections::BTreeMap;

use crate::cli::comparison::announce;
use crate::client::{AlertReport, Gateway};
use crate::ids::RouteId;

/// Reports each alert once, and again whenever its status changes.
#[derive(Default)]
pub(super) struct AlertWatch {
    /// The status that was reported last, by alert.
    reported: BTreeMap<String, String>,
}

impl AlertWatch {
    /// A line for each alert whose status is another than reported before.
    pub(super) async fn news(
        &mut self,
        gateway: &Gateway,
        route: &RouteId,
    ) -> anyhow::Result<Vec<String>> {
        let alerts = gateway.alerts(route).await?.unwrap_or_default();
        let mut news: Vec<&AlertReport> = (alerts.iter())
            .filter(|alert| self.reported.get(&alert.id) != Some(&alert.status))
            .collect();
        news.sort_by(|a, b| a.id.cmp(&b.id));
        let known = news.iter().map(|a| (a.id.clone(), a.status.clone()));
        self.reported.extend(known);
        Ok(news.into_iter().map(announce).collect())
    }
}

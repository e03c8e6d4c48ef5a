//! How webhooks present the subjects of events: as the interface answers them, with a link to the console.

use crate::api::access::PublicUrl;
use crate::api::alerts::alert_text;
use crate::api::batch_body::BatchBody;
use crate::api::operation::OperationBody;
use crate::api::vehicles::VehicleBody;
use crate::ids::AlertId;
use crate::store::{AlertRecord, BatchRecord, OperationRecord, Subject, VehicleRecord};
use crate::webhooks::Forms;

/// Presents subjects as this interface does.
pub struct EventForms {
    /// The URL under which people reach the service.
    public_url: Option<PublicUrl>,
}

impl EventForms {
    /// With links to the console under this URL.
    pub fn new(public_url: Option<PublicUrl>) -> Self {
        Self { public_url }
    }
}

impl Forms for EventForms {
    fn alert(&self, alert: AlertRecord) -> Result<String, serde_json::Error> {
        alert_text(alert)
    }

    fn batch(&self, batch: BatchRecord, alerts: &[AlertId]) -> Result<String, serde_json::Error> {
        serde_json::to_string(&BatchBody::new(batch, alerts)?)
    }

    fn vehicle(&self, vehicle: VehicleRecord) -> Result<String, serde_json::Error> {
        serde_json::to_string(&VehicleBody::from(vehicle))
    }

    fn operation(&self, operation: OperationRecord) -> Result<String, serde_json::Error> {
        serde_json::to_string(&OperationBody::of(operation, 1.0))
    }

    /// The addresses of `page/address.js`. Names of routes need no escaping; the console does not show operations.
    fn url(&self, subject: &Subject) -> Option<String> {
        let origin = self.public_url.as_ref()?.origin();
        match subject {
            Subject::Alert(id) => Some(format!("{origin}/#/alerts/{id}")),
            Subject::Batch(route, _) => Some(format!("{origin}/#/routes/{route}/batches")),
            Subject::Vehicle(route, _) => Some(format!("{origin}/#/routes/{route}/vehicles")),
            Subject::Operation(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::{OperationId, RouteId, VehicleId};

    #[test]
    fn links_lead_to_the_page_where_people_reach_it() {
        let public_url = "https://Maps.Example.com:443/".parse().unwrap();
        let forms = EventForms::new(Some(public_url));
        let alert = Subject::Alert("019aa000-0000-7000-8000-000000000001".parse().unwrap());
        let url = "https://maps.example.com/#/alerts/019aa000-0000-7000-8000-000000000001";
        assert_eq!(forms.url(&alert).as_deref(), Some(url));
        let route = RouteId::new("line-4").unwrap();
        let vehicle = Subject::Vehicle(route, VehicleId::new("agv-07").unwrap());
        let url = "https://maps.example.com/#/routes/line-4/vehicles";
        assert_eq!(forms.url(&vehicle).as_deref(), Some(url));
        let operation = Subject::Operation(OperationId(uuid::Uuid::nil()));
        assert_eq!(forms.url(&operation), None);
        assert_eq!(EventForms::new(None).url(&alert), None);
    }
}

//! Whether a service answers.

use reqwest::Method;

use super::{Gateway, GatewayError, Refusal, Request, innermost};

impl Gateway {
    /// Checks once whether the service is ready; `Some` states why it is not.
    pub async fn readiness(&self) -> Result<Option<String>, GatewayError> {
        let request = Request {
            method: Method::GET,
            path: "/readyz".to_owned(),
            what: "readiness".to_owned(),
            body: None,
            gzip: false,
        };
        match self.attempt(&request).await {
            Ok(answer) if answer.status.is_success() => Ok(None),
            Ok(answer) => Ok(Some(Refusal::read(answer.status, &answer.body).to_string())),
            Err(source) if source.is_builder() => Err(GatewayError::Url {
                url: self.url.clone(),
                source,
            }),
            Err(source) => Ok(Some(innermost(&source))),
        }
    }
}

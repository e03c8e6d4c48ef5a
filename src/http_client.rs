//! The HTTP client of this program: its user agent, no redirects, TLS.
//!
//! Must not know what is sent where. Begin with [`builder`].

use reqwest::{ClientBuilder, redirect};
use rustls::crypto::ring;

const USER_AGENT: &str = concat!("mapshift/", env!("CARGO_PKG_VERSION"));

/// A client that names this program, follows no redirects, and trusts the certificates of the
/// system. Building it fails on a system without any.
pub fn builder() -> ClientBuilder {
    // reqwest uses the provider of the process; an error means that one is installed already.
    let _ = ring::default_provider().install_default();
    reqwest::Client::builder()
        .user_agent(USER_AGENT)
        .redirect(redirect::Policy::none())
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::AsyncReadExt;
    use tokio::net::TcpListener;

    #[tokio::test]
    async fn https_begins_with_a_handshake() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("https://{}/", listener.local_addr().unwrap());
        let receiver = tokio::spawn(async move {
            let (mut connection, _) = listener.accept().await.unwrap();
            let mut head = [0; 6];
            connection.read_exact(&mut head).await.unwrap();
            head
        });
        let client = builder().no_proxy().tls_certs_only([]).build().unwrap();
        assert!(client.get(url).send().await.unwrap_err().is_connect());
        // A record of TLS (22 is a handshake), and in it a ClientHello (1).
        let [record, version, _, _, _, message] = receiver.await.unwrap();
        assert_eq!((record, version, message), (22, 3, 1));
    }
}

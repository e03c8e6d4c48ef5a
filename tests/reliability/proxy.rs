//! A bad line between gateways and a service: drops, cuts, resets, stalls, doubles and corrupts.
//!
//! It expects one request on each connection. A seed decides the fate of the n-th connection.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

const STALL: Duration = Duration::from_millis(100);

/// What may happen to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    /// Nothing.
    Pass,
    /// It is not passed on.
    Drop,
    /// Its first half is passed on.
    Cut,
    /// It is passed on, and the connection reset instead of an answer.
    Reset,
    /// It is passed on, and half the answer comes back.
    CutAnswer,
    /// It comes in two parts with a pause between.
    Stall,
    /// It is passed on twice at once.
    Double,
    /// A bit of its body is flipped.
    Corrupt,
}

const FAULTS: [Fate; 7] = [
    Fate::Drop,
    Fate::Cut,
    Fate::Reset,
    Fate::CutAnswer,
    Fate::Stall,
    Fate::Double,
    Fate::Corrupt,
];

/// A running proxy.
pub struct Proxy {
    pub url: String,
    faults: Arc<AtomicUsize>,
}

impl Proxy {
    /// Passes on to a service; such a share of the requests has a fault.
    pub async fn start(service: SocketAddr, share: f64, seed: u64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let faults = Arc::new(AtomicUsize::new(0));
        let noted = faults.clone();
        tokio::spawn(async move {
            for number in 0.. {
                let Ok((connection, _)) = listener.accept().await else {
                    break;
                };
                let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003) + number);
                let fate = match rng.random_bool(share) {
                    true => FAULTS[rng.random_range(0..FAULTS.len())],
                    false => Fate::Pass,
                };
                noted.fetch_add(usize::from(fate != Fate::Pass), Ordering::Relaxed);
                // An error is a side that has gone, which is what proxies are for.
                tokio::spawn(async move {
                    let _ = pass_on(connection, service, fate, rng).await;
                });
            }
        });
        Self { url, faults }
    }

    /// Requests that had a fault so far.
    pub fn faults(&self) -> usize {
        self.faults.load(Ordering::Relaxed)
    }
}

async fn pass_on(
    mut client: TcpStream,
    service: SocketAddr,
    fate: Fate,
    mut rng: ChaCha8Rng,
) -> std::io::Result<()> {
    let mut request = read_request(&mut client).await?;
    let half = request.bytes.len() / 2;
    let answer = match fate {
        Fate::Drop => return Ok(()),
        Fate::Cut => {
            let mut connection = TcpStream::connect(service).await?;
            return connection.write_all(&request.bytes[..half]).await;
        }
        Fate::Stall => {
            let mut connection = TcpStream::connect(service).await?;
            connection.write_all(&request.bytes[..half]).await?;
            tokio::time::sleep(STALL).await;
            connection.write_all(&request.bytes[half..]).await?;
            answer_of(connection).await?
        }
        Fate::Double => {
            let (one, other) =
                tokio::join!(ask(service, &request.bytes), ask(service, &request.bytes));
            one.or(other)?
        }
        Fate::Corrupt => {
            let body = request.head_length..request.bytes.len();
            if !body.is_empty() {
                request.bytes[rng.random_range(body)] ^= 1 << rng.random_range(0..8);
            }
            ask(service, &request.bytes).await?
        }
        Fate::Pass | Fate::Reset | Fate::CutAnswer => ask(service, &request.bytes).await?,
    };
    match fate {
        Fate::Reset => client.set_zero_linger(),
        Fate::CutAnswer => client.write_all(&answer[..answer.len() / 2]).await,
        _ => client.write_all(&answer).await,
    }
}

/// A request's bytes, the first of which are its head.
struct Bytes {
    bytes: Vec<u8>,
    head_length: usize,
}

async fn read_request(client: &mut TcpStream) -> std::io::Result<Bytes> {
    let mut bytes = Vec::new();
    loop {
        if client.read_buf(&mut bytes).await? == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        let Some(end) = bytes.windows(4).position(|window| window == b"\r\n\r\n") else {
            continue;
        };
        let head = String::from_utf8_lossy(&bytes[..end]).to_lowercase();
        let length = head
            .lines()
            .find_map(|line| line.strip_prefix("content-length:"));
        let length = length.map_or(0, |text| text.trim().parse().unwrap());
        let head_length = end + 4;
        if bytes.len() >= head_length + length {
            return Ok(Bytes { bytes, head_length });
        }
    }
}

async fn ask(service: SocketAddr, request: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut connection = TcpStream::connect(service).await?;
    connection.write_all(request).await?;
    answer_of(connection).await
}

/// Everything up to the end: the service closes after each answer, as gateways ask it to.
async fn answer_of(mut connection: TcpStream) -> std::io::Result<Vec<u8>> {
    let mut answer = Vec::new();
    connection.read_to_end(&mut answer).await?;
    Ok(answer)
}

//! `mapshift keys`: in the data directory while no service runs on it, else over HTTP.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clap::Subcommand;
use jiff::{SignedDuration, Timestamp};
use uuid::Uuid;

use super::key_arg::KeyArg;
use crate::client::{Gateway, KeyReport, KeyRequest};
use crate::ids::{KeyId, RouteId, VehicleId};
use crate::model::{Actor, Role, TextEnum as _, checked_holder};
use crate::store::{KeyRecord, KeyText, NewKey, Secret, Store, StoreError, StoreOptions};

const URL: &str = "http://127.0.0.1:8080";
/// The origin of changes without the service, for the audit.
const COMMAND_LINE: &str = "command line";
/// Keys of one page.
const PAGE: u32 = 1_000;

/// Arguments of `mapshift keys`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Directory of the database. If a service runs on it, it is used over HTTP instead.
    #[arg(
        long,
        global = true,
        env = "MAPSHIFT_DATA_DIR",
        default_value = "./data"
    )]
    data: PathBuf,
    /// Use the service at this address, with an administrator's key.
    #[arg(long, global = true)]
    url: Option<String>,
    #[command(flatten)]
    key: KeyArg,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Create a key and print it: it cannot be shown again.
    Create(CreateArgs),
    /// List keys.
    List,
    /// Revoke a key; it is refused from now on.
    Revoke {
        /// Its id, as `list` prints it.
        id: KeyId,
    },
}

#[derive(Debug, clap::Args)]
struct CreateArgs {
    /// Its holder: a person or a machine.
    #[arg(long, value_parser = parse_name)]
    name: String,
    /// vehicle, viewer, maintainer or admin.
    #[arg(long, value_parser = parse_role)]
    role: Role,
    /// The only vehicle that it may upload for; with role vehicle only.
    #[arg(long)]
    vehicle: Option<VehicleId>,
    /// Limit it to this route; may be given several times. Not with role admin.
    #[arg(long = "route", value_name = "ROUTE")]
    routes: Vec<RouteId>,
    /// Days until it expires; by default never.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=3_650))]
    expires_days: Option<u16>,
}

/// Where keys are stored.
enum Keys {
    Here(Store),
    There(Gateway),
}

/// Runs the command.
///
/// # Errors
/// If neither the directory nor the service can be used, or the key is refused.
pub fn run(args: &Args) -> anyhow::Result<()> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .context("the runtime could not be started")?
        .block_on(carry_out(args))
}

async fn carry_out(args: &Args) -> anyhow::Result<()> {
    let keys = Keys::find(args).await?;
    match &args.command {
        Command::Create(create) => {
            let made = keys.create(create.request(Timestamp::now())?).await?;
            note("This key is shown once: keep it where its holder alone can read it.");
            writeln!(std::io::stdout(), "{made}")?;
        }
        Command::List => {
            let mut out = std::io::stdout().lock();
            for key in keys.list().await? {
                writeln!(out, "{}", line(&key))?;
            }
        }
        Command::Revoke { id } => {
            keys.revoke(*id).await?;
            note(&format!("key {id} is revoked"));
        }
    }
    keys.close().await
}

impl CreateArgs {
    fn request(&self, now: Timestamp) -> anyhow::Result<KeyRequest> {
        if self.vehicle.is_some() && self.role != Role::Vehicle {
            bail!("--vehicle goes with --role vehicle alone");
        }
        if !self.routes.is_empty() && self.role == Role::Admin {
            bail!("an admin may make keys for every route, and is not limited to some");
        }
        let days = |days| now + SignedDuration::from_hours(24 * i64::from(days));
        Ok(KeyRequest {
            name: self.name.clone(),
            role: self.role,
            vehicle_id: self.vehicle.clone(),
            routes: (!self.routes.is_empty()).then(|| self.routes.clone()),
            expires_at: self.expires_days.map(days),
        })
    }
}

impl Keys {
    async fn find(args: &Args) -> anyhow::Result<Self> {
        let there = |url: &str| Gateway::new(url, args.key.key.as_deref(), note);
        if let Some(url) = &args.url {
            return Ok(Self::There(there(url)?));
        }
        match open(&args.data).await {
            Ok(store) => Ok(Self::Here(store)),
            Err(StoreError::Locked(_)) => {
                note(&format!(
                    "a service runs on {}: asking it at {URL} (--url names another)",
                    args.data.display()
                ));
                Ok(Self::There(there(URL)?))
            }
            Err(error) => Err(error)
                .with_context(|| format!("cannot open the store in {}", args.data.display())),
        }
    }

    /// Creates a key and returns its secret.
    async fn create(&self, request: KeyRequest) -> anyhow::Result<String> {
        match self {
            Self::There(gateway) => {
                let made = gateway.create_key(&request).await?;
                made.key.context("the service has not shown the key")
            }
            Self::Here(store) => {
                let (id, secret) = (KeyId(Uuid::now_v7()), Secret::random()?);
                let key = NewKey {
                    id,
                    secret: secret.clone(),
                    name: request.name,
                    role: request.role,
                    vehicle_id: request.vehicle_id,
                    routes: request.routes,
                    created_at: Timestamp::now(),
                    expires_at: request.expires_at,
                };
                store.create_key(key, &by()).await?;
                Ok(KeyText { id, secret }.text())
            }
        }
    }

    async fn list(&self) -> anyhow::Result<Vec<KeyReport>> {
        let store = match self {
            Self::There(gateway) => return Ok(gateway.keys().await?),
            Self::Here(store) => store,
        };
        let mut keys: Vec<KeyReport> = Vec::new();
        loop {
            let after = keys.last().map(|key| key.id);
            let page = store.keys(after, PAGE).await?;
            if page.is_empty() {
                return Ok(keys);
            }
            keys.extend(page.into_iter().map(report));
        }
    }

    async fn revoke(&self, id: KeyId) -> anyhow::Result<()> {
        match self {
            Self::There(gateway) => Ok(gateway.revoke_key(id).await?),
            Self::Here(store) => match store.revoke_key(id, &by(), Timestamp::now()).await? {
                true => Ok(()),
                false => bail!("there is no key {id}: mapshift keys list prints them"),
            },
        }
    }

    async fn close(self) -> anyhow::Result<()> {
        match self {
            Self::There(_) => Ok(()),
            Self::Here(store) => store.close().await.context("the store did not close"),
        }
    }
}

async fn open(data: &Path) -> Result<Store, StoreError> {
    let data_dir = data.to_path_buf();
    Store::open(StoreOptions { data_dir }).await
}

/// Prints a message for people to standard error; standard output is for keys.
fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

fn by() -> Actor {
    Actor::Local {
        address: COMMAND_LINE.to_owned(),
    }
}

fn report(key: KeyRecord) -> KeyReport {
    KeyReport {
        id: key.id,
        name: key.name,
        role: key.role,
        vehicle_id: key.vehicle_id,
        routes: key.routes,
        last_used_at: key.last_used_at,
        expires_at: key.expires_at,
        revoked_at: key.revoked_at,
        key: None,
    }
}

/// A key in a line for people: its purpose and whether it is valid.
fn line(key: &KeyReport) -> String {
    let mut text = format!("{}  {}  {}", key.id, key.role.name(), key.name);
    if let Some(vehicle) = &key.vehicle_id {
        text.push_str(&format!(", vehicle {vehicle}"));
    }
    for route in key.routes.iter().flatten() {
        text.push_str(&format!(", route {route}"));
    }
    match key.last_used_at {
        Some(at) => text.push_str(&format!(", last used {at:.0}")),
        None => text.push_str(", never used"),
    }
    match (key.revoked_at, key.expires_at) {
        (Some(at), _) => text.push_str(&format!(", revoked {at:.0}")),
        (None, Some(at)) => text.push_str(&format!(", valid until {at:.0}")),
        (None, None) => {}
    }
    text
}

fn parse_name(text: &str) -> Result<String, String> {
    checked_holder(text)
        .map(str::to_owned)
        .map_err(|refusal| refusal.to_string())
}

fn parse_role(text: &str) -> Result<Role, String> {
    Role::of_text(text).map_err(|unknown| unknown.to_string())
}

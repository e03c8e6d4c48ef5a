//! Identities that a trusted proxy states in headers.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

use axum::http::{HeaderMap, HeaderValue};
use ipnet::IpNet;

use super::identity::Identity;
use crate::api::problem::{Problem, ProblemKind};
use crate::model::{Role, TextEnum as _, UnknownText, checked_holder};

/// The headers with a person's name and groups, as the two common kinds of proxies call them.
const FAMILIES: [[&str; 2]; 2] = [
    ["x-auth-request-user", "x-auth-request-groups"],
    ["x-forwarded-user", "x-forwarded-groups"],
];

/// The proxies whose headers are trusted, and the roles of groups.
#[derive(Debug, Clone, Default)]
pub struct TrustedProxies {
    /// The networks of the proxies.
    pub networks: Vec<Network>,
    /// The roles of members of groups; a member of several has the highest.
    pub roles: Vec<GroupRole>,
}

/// A network of addresses, such as `10.1.0.0/16`, or a single address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Network(IpNet);

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// The text is not a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("give addresses like 10.1.0.0/16, 127.0.0.1 or fd00::/8")]
pub struct InvalidNetwork;

/// The role of the members of a group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GroupRole {
    group: String,
    role: Role,
}

impl fmt::Display for GroupRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.group, self.role.name())
    }
}

/// The text does not assign a role to a group.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidGroupRole {
    /// It has no `=`.
    #[error("give a group and its role, like map-keepers=maintainer")]
    Form,
    /// There is no such role.
    #[error(transparent)]
    Role(#[from] UnknownText),
}

impl Network {
    /// Whether it contains every address.
    pub fn is_everybody(&self) -> bool {
        self.0.prefix_len() == 0
    }
}

impl FromStr for Network {
    type Err = InvalidNetwork;

    fn from_str(text: &str) -> Result<Self, InvalidNetwork> {
        let network = text.parse::<IpNet>().ok();
        let address = || text.parse::<IpAddr>().ok().map(IpNet::from);
        network.or_else(address).map(Self).ok_or(InvalidNetwork)
    }
}

impl FromStr for GroupRole {
    type Err = InvalidGroupRole;

    fn from_str(text: &str) -> Result<Self, InvalidGroupRole> {
        let (group, role) = text.rsplit_once('=').ok_or(InvalidGroupRole::Form)?;
        if group.is_empty() || group.contains(',') {
            return Err(InvalidGroupRole::Form);
        }
        Ok(Self {
            group: group.to_owned(),
            role: Role::of_text(role)?,
        })
    }
}

impl TrustedProxies {
    /// The sender of a request, if the peer of the connection is a trusted proxy that names one.
    ///
    /// # Errors
    /// A [`Problem`] if there are several statements, one of which may come from the client.
    pub(super) fn identity(
        &self,
        peer: Option<IpAddr>,
        headers: &HeaderMap,
    ) -> Result<Option<Identity>, Problem> {
        let is_trusted = |peer: IpAddr| self.networks.iter().any(|own| own.0.contains(&peer));
        if !peer.is_some_and(is_trusted) {
            return Ok(None);
        }
        let is_stated = |family: &&[&str; 2]| family.iter().any(|name| headers.contains_key(*name));
        let mut stated = FAMILIES.iter().filter(is_stated);
        let (Some([user, groups]), None) = (stated.next(), stated.next()) else {
            return match FAMILIES.iter().any(|family| is_stated(&family)) {
                true => Err(ambiguous()),
                false => Ok(None),
            };
        };
        let Some(name) = only(headers, user)? else {
            return Ok(None);
        };
        let name = checked_holder(name).map_err(|refusal| {
            let detail = format!("the name in {user} cannot be used: {refusal}");
            Problem::new(ProblemKind::Forbidden, detail)
        })?;
        let groups = only(headers, groups)?.unwrap_or_default();
        Ok(Some(Identity::of_proxy(name.to_owned(), self.role(groups))))
    }

    /// The highest role of these groups.
    fn role(&self, groups: &str) -> Option<Role> {
        let is_member = |of: &&GroupRole| groups.split(',').any(|group| group.trim() == of.group);
        let roles = self.roles.iter().filter(is_member);
        roles.map(|of| of.role).max()
    }
}

/// The single value of a header.
fn only<'a>(headers: &'a HeaderMap, name: &str) -> Result<Option<&'a str>, Problem> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (_, Some(_)) => Err(ambiguous()),
        (value, None) => value.map(text_of).transpose(),
    }
}

fn text_of(value: &HeaderValue) -> Result<&str, Problem> {
    std::str::from_utf8(value.as_bytes()).map_err(|_| {
        let detail = "the proxy's headers are not UTF-8";
        Problem::new(ProblemKind::Forbidden, detail)
    })
}

fn ambiguous() -> Problem {
    let detail = "the proxy forwards more than one statement of who you are; configure it to remove \
                  X-Forwarded-User, X-Forwarded-Groups, X-Auth-Request-User and \
                  X-Auth-Request-Groups sent by clients, and to set only one kind itself";
    Problem::new(ProblemKind::Forbidden, detail)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proxies() -> TrustedProxies {
        TrustedProxies {
            networks: vec!["10.1.0.0/16".parse().unwrap(), "::1".parse().unwrap()],
            roles: ["keepers=maintainer", "everyone=viewer", "a=b=admin"]
                .iter()
                .map(|text| text.parse().unwrap())
                .collect(),
        }
    }

    fn asked(peer: &str, headers: &[(&'static str, &str)]) -> Result<Option<Identity>, Problem> {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append(*name, HeaderValue::from_bytes(value.as_bytes()).unwrap());
        }
        proxies().identity(Some(peer.parse().unwrap()), &map)
    }

    #[test]
    fn a_trusted_proxy_names_people_and_groups() {
        for (groups, role) in [
            ("everyone,keepers", Some(Role::Maintainer)),
            ("keepers , other", Some(Role::Maintainer)),
            ("everyone", Some(Role::Viewer)),
            ("a=b", Some(Role::Admin)),
            ("keeper", None),
            ("", None),
        ] {
            for [user, of] in FAMILIES {
                let stated = asked("10.1.2.3", &[(user, "Kovács"), (of, groups)]);
                let identity = stated.unwrap().unwrap();
                assert_eq!((identity.name(), identity.role), (Some("Kovács"), role));
            }
        }
    }

    #[test]
    fn only_trusted_proxies_are_believed() {
        let headers = [("x-forwarded-user", "kim"), ("x-forwarded-groups", "a=b")];
        for peer in ["10.2.0.1", "127.0.0.1", "::2"] {
            assert!(asked(peer, &headers).unwrap().is_none(), "{peer}");
        }
        assert!(asked("::1", &headers).unwrap().is_some());
        assert!(asked("::1", &[]).unwrap().is_none());
        assert!(asked("::1", &headers[1..]).unwrap().is_none());
    }

    #[test]
    fn ambiguous_headers_are_refused() {
        for headers in [
            [
                ("x-auth-request-user", "kim"),
                ("x-forwarded-groups", "a=b"),
            ],
            [("x-auth-request-user", "kim"), ("x-forwarded-user", "root")],
            [("x-forwarded-user", "kim"), ("x-forwarded-user", "root")],
        ] {
            assert!(asked("::1", &headers).is_err(), "{headers:?}");
        }
        assert!(asked("::1", &[("x-forwarded-user", "system")]).is_err());
    }

    #[test]
    fn settings_are_checked() {
        for bad in ["", "10.1.0.0/40", "example.com"] {
            assert!(bad.parse::<Network>().is_err(), "{bad}");
        }
        for bad in ["keepers", "=admin", "keepers=root", "a,b=admin"] {
            assert!(bad.parse::<GroupRole>().is_err(), "{bad}");
        }
    }
}

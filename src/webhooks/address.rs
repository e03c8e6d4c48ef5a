//! Which addresses webhooks are sent to.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Where receivers of webhooks may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ReceiverPolicy {
    /// On the internet, by https: the service cannot be made to call its own network.
    #[default]
    Public,
    /// In private networks too, also by http.
    PrivateToo,
}

impl ReceiverPolicy {
    /// Whether a connection to the address is allowed.
    ///
    /// # Errors
    /// A description of the address.
    pub fn check_address(self, address: IpAddr) -> Result<(), &'static str> {
        match (zone_of(address), self) {
            (Zone::Public, _) | (Zone::Private(_), Self::PrivateToo) => Ok(()),
            (Zone::Private(what) | Zone::Never(what), _) => Err(what),
        }
    }
}

/// The kind of an address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Zone {
    /// Public.
    Public,
    /// A machine of a private network, or this one.
    Private(&'static str),
    /// Reserved, or a metadata service of a cloud.
    Never(&'static str),
}

const LOOPBACK: Zone = Zone::Private("this machine itself");
const PRIVATE: Zone = Zone::Private("in a private network");
const LINK_LOCAL: Zone = Zone::Never("link-local, where clouds keep the keys of a machine");
const CLOUD: Zone = Zone::Never("where clouds keep the keys of a machine");
const DOCUMENTATION: Zone = Zone::Never("reserved for documentation");
const MULTICAST: Zone = Zone::Never("multicast");
const RESERVED: Zone = Zone::Never("reserved");
const DISGUISED: Zone = Zone::Never("an IPv4 address in another form");

/// First address, length of the prefix, zone; what is in no row is public. From the IANA IPv4
/// Special-Purpose Address Registry (RFC 6890), and an address that Azure serves machines at.
const IPV4: [(Ipv4Addr, u32, Zone); 16] = [
    (Ipv4Addr::new(0, 0, 0, 0), 8, RESERVED),
    (Ipv4Addr::new(10, 0, 0, 0), 8, PRIVATE),
    (Ipv4Addr::new(100, 64, 0, 0), 10, PRIVATE),
    (Ipv4Addr::new(127, 0, 0, 0), 8, LOOPBACK),
    (Ipv4Addr::new(168, 63, 129, 16), 32, CLOUD),
    (Ipv4Addr::new(169, 254, 0, 0), 16, LINK_LOCAL),
    (Ipv4Addr::new(172, 16, 0, 0), 12, PRIVATE),
    (Ipv4Addr::new(192, 0, 0, 0), 24, RESERVED),
    (Ipv4Addr::new(192, 0, 2, 0), 24, DOCUMENTATION),
    (Ipv4Addr::new(192, 88, 99, 0), 24, RESERVED),
    (Ipv4Addr::new(192, 168, 0, 0), 16, PRIVATE),
    (Ipv4Addr::new(198, 18, 0, 0), 15, RESERVED),
    (Ipv4Addr::new(198, 51, 100, 0), 24, DOCUMENTATION),
    (Ipv4Addr::new(203, 0, 113, 0), 24, DOCUMENTATION),
    (Ipv4Addr::new(224, 0, 0, 0), 4, MULTICAST),
    (Ipv4Addr::new(240, 0, 0, 0), 4, RESERVED),
];

/// The first row that fits decides; what is in no row is reserved. From the IANA IPv6
/// Special-Purpose Address Registry, and addresses that Amazon and Google serve machines at.
const IPV6: [(Ipv6Addr, u32, Zone); 14] = [
    (Ipv6Addr::LOCALHOST, 128, LOOPBACK),
    (v6([0, 0, 0, 0, 0, 0xffff, 0, 0]), 96, DISGUISED),
    (v6([0x64, 0xff9b, 0, 0, 0, 0, 0, 0]), 96, DISGUISED),
    (v6([0x64, 0xff9b, 1, 0, 0, 0, 0, 0]), 48, DISGUISED),
    (v6([0x2002, 0, 0, 0, 0, 0, 0, 0]), 16, DISGUISED),
    // Teredo among them.
    (v6([0x2001, 0, 0, 0, 0, 0, 0, 0]), 23, RESERVED),
    (v6([0x2001, 0xdb8, 0, 0, 0, 0, 0, 0]), 32, DOCUMENTATION),
    (v6([0x3fff, 0, 0, 0, 0, 0, 0, 0]), 20, DOCUMENTATION),
    (v6([0x2000, 0, 0, 0, 0, 0, 0, 0]), 3, Zone::Public),
    (v6([0xfd00, 0xec2, 0, 0, 0, 0, 0, 0x254]), 128, CLOUD),
    (v6([0xfd20, 0xce, 0, 0, 0, 0, 0, 0x254]), 128, CLOUD),
    (v6([0xfc00, 0, 0, 0, 0, 0, 0, 0]), 7, PRIVATE),
    (v6([0xfe80, 0, 0, 0, 0, 0, 0, 0]), 10, LINK_LOCAL),
    (v6([0xff00, 0, 0, 0, 0, 0, 0, 0]), 8, MULTICAST),
];

const fn v6(parts: [u16; 8]) -> Ipv6Addr {
    let [a, b, c, d, e, f, g, h] = parts;
    Ipv6Addr::new(a, b, c, d, e, f, g, h)
}

fn zone_of(address: IpAddr) -> Zone {
    match address {
        IpAddr::V4(address) => {
            let fits = |(first, prefix, _): &&(Ipv4Addr, u32, Zone)| {
                (address.to_bits() ^ first.to_bits()).leading_zeros() >= *prefix
            };
            IPV4.iter()
                .find(fits)
                .map_or(Zone::Public, |(_, _, zone)| *zone)
        }
        IpAddr::V6(address) => {
            let fits = |(first, prefix, _): &&(Ipv6Addr, u32, Zone)| {
                (address.to_bits() ^ first.to_bits()).leading_zeros() >= *prefix
            };
            IPV6.iter()
                .find(fits)
                .map_or(RESERVED, |(_, _, zone)| *zone)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn allowed(policy: ReceiverPolicy, address: &str) -> bool {
        policy.check_address(address.parse().unwrap()).is_ok()
    }

    #[test]
    fn the_borders_of_every_range_are_where_the_registries_have_them() {
        // Just before, first, last, just after.
        for [before, first, last, after] in [
            ["9.255.255.255", "10.0.0.0", "10.255.255.255", "11.0.0.0"],
            [
                "100.63.255.255",
                "100.64.0.0",
                "100.127.255.255",
                "100.128.0.0",
            ],
            [
                "126.255.255.255",
                "127.0.0.0",
                "127.255.255.255",
                "128.0.0.0",
            ],
            [
                "169.253.255.255",
                "169.254.0.0",
                "169.254.255.255",
                "169.255.0.0",
            ],
            [
                "172.15.255.255",
                "172.16.0.0",
                "172.31.255.255",
                "172.32.0.0",
            ],
            ["191.255.255.255", "192.0.0.0", "192.0.0.255", "192.0.1.0"],
            ["192.0.1.255", "192.0.2.0", "192.0.2.255", "192.0.3.0"],
            [
                "192.88.98.255",
                "192.88.99.0",
                "192.88.99.255",
                "192.88.100.0",
            ],
            [
                "192.167.255.255",
                "192.168.0.0",
                "192.168.255.255",
                "192.169.0.0",
            ],
            [
                "198.17.255.255",
                "198.18.0.0",
                "198.19.255.255",
                "198.20.0.0",
            ],
            [
                "198.51.99.255",
                "198.51.100.0",
                "198.51.100.255",
                "198.51.101.0",
            ],
            [
                "203.0.112.255",
                "203.0.113.0",
                "203.0.113.255",
                "203.0.114.0",
            ],
            [
                "168.63.129.15",
                "168.63.129.16",
                "168.63.129.16",
                "168.63.129.17",
            ],
            [
                "2001:200::",
                "2001:db8::",
                "2001:db8:ffff:ffff:ffff:ffff:ffff:ffff",
                "2001:db9::",
            ],
            [
                "2001:ffff::",
                "2002::",
                "2002:ffff:ffff:ffff:ffff:ffff:ffff:ffff",
                "2003::",
            ],
            [
                "3ffe::",
                "3fff::",
                "3fff:fff:ffff:ffff:ffff:ffff:ffff:ffff",
                "3fff:1000::",
            ],
        ] {
            for outside in [before, after] {
                assert!(allowed(ReceiverPolicy::Public, outside), "{outside}");
            }
            for inside in [first, last] {
                assert!(!allowed(ReceiverPolicy::Public, inside), "{inside}");
            }
        }
        for end in ["0.0.0.0", "0.255.255.255", "224.0.0.0", "255.255.255.255"] {
            assert!(!allowed(ReceiverPolicy::PrivateToo, end), "{end}");
        }
        assert!(allowed(ReceiverPolicy::Public, "1.0.0.0"));
        assert!(allowed(ReceiverPolicy::Public, "223.255.255.255"));
    }

    #[test]
    fn private_networks_are_a_choice_and_the_rest_is_none() {
        for address in [
            "10.1.2.3",
            "172.20.0.1",
            "192.168.1.9",
            "100.100.1.1",
            "127.0.0.1",
            "::1",
            "fd12::1",
        ] {
            assert!(!allowed(ReceiverPolicy::Public, address), "{address}");
            assert!(allowed(ReceiverPolicy::PrivateToo, address), "{address}");
        }
        for address in [
            "169.254.169.254",
            "168.63.129.16",
            "fd00:ec2::254",
            "fd20:ce::254",
            "fe80::1",
            "::",
            "::ffff:10.0.0.1",
            "::ffff:8.8.8.8",
            "::8.8.8.8",
            "64:ff9b::808:808",
            "64:ff9b:1::1",
            "2002:808:808::1",
            "2001::1",
            "ff02::1",
            "fec0::1",
            "5f00::1",
            "100::1",
            "4000::1",
        ] {
            assert!(!allowed(ReceiverPolicy::Public, address), "{address}");
            assert!(!allowed(ReceiverPolicy::PrivateToo, address), "{address}");
        }
    }
}

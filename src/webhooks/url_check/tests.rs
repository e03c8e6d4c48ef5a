use super::*;

/// Each leads, or pretends to lead, where nobody outside may send the service.
const REFUSED: [&str; 92] = [
    // Loopback in all its spellings.
    "https://127.0.0.1/",
    "https://127.0.0.1:8443/hook",
    "https://127.1/",
    "https://127.0.1/",
    "https://2130706433/",
    "https://0x7f000001/",
    "https://0x7f.0.0.1/",
    "https://0177.0.0.1/",
    "https://017700000001/",
    "https://127.255.255.254/",
    "https://127.0.0.1./",
    "https://127。0。0。1/",
    "https://①②⑦.⓪.⓪.①/",
    "https://%31%32%37.0.0.1/",
    "https://[::1]/",
    "https://[0:0:0:0:0:0:0:1]/",
    "https://localhost/",
    "https://LOCALHOST/",
    "https://localhost./",
    "https://ⓛocalhost/",
    "https://hooks.localhost/",
    "https://localhost.localdomain/",
    // The unspecified address reaches this machine as well.
    "https://0.0.0.0/",
    "https://0/",
    "https://[::]/",
    "https://0.1.2.3/",
    // Private networks.
    "https://10.0.0.1/",
    "https://10.255.255.255/",
    "https://172.16.0.1/",
    "https://172.31.255.255/",
    "https://192.168.0.1/",
    "https://192.168.1.1:443/",
    "https://0xc0a80001/",
    "https://3232235521/",
    "https://[fc00::1]/",
    "https://[fd12:3456:789a::1]/",
    "https://100.64.0.1/",
    "https://100.127.255.255/",
    "https://100.100.100.200/latest/meta-data/",
    // What clouds keep for a machine.
    "https://169.254.169.254/latest/meta-data/",
    "https://2852039166/latest/meta-data/",
    "https://0xa9fea9fe/",
    "https://169.254.170.2/v2/credentials",
    "https://[fd00:ec2::254]/",
    "https://[fd20:ce::254]/",
    "https://168.63.129.16/machine",
    "https://192.0.0.192/",
    "https://metadata.google.internal/",
    "https://metadata/",
    "https://instance-data/",
    // Link-local, multicast, broadcast, reserved, documentation, benchmarks.
    "https://169.254.1.1/",
    "https://[fe80::1]/",
    "https://[febf::1]/",
    "https://[fec0::1]/",
    "https://224.0.0.1/",
    "https://239.255.255.250/",
    "https://[ff02::1]/",
    "https://255.255.255.255/",
    "https://240.0.0.1/",
    "https://192.0.2.1/",
    "https://198.51.100.7/",
    "https://203.0.113.9/",
    "https://198.18.0.1/",
    "https://192.88.99.1/",
    "https://[2001:db8::1]/",
    "https://[3fff::1]/",
    "https://[100::1]/",
    "https://[5f00::1]/",
    // IPv4 in the clothes of IPv6.
    "https://[::ffff:127.0.0.1]/",
    "https://[::ffff:7f00:1]/",
    "https://[::ffff:8.8.8.8]/",
    "https://[::127.0.0.1]/",
    "https://[64:ff9b::7f00:1]/",
    "https://[64:ff9b:1::a00:1]/",
    "https://[2002:7f00:1::]/",
    "https://[2001:0:7f00:1::]/",
    // Names of one network.
    "https://printer.local/",
    "https://wiki.corp/",
    "https://nas.lan/",
    "https://router.home.arpa/",
    "https://kubernetes.default.svc/",
    "https://intranet/",
    // Not https, or not only a place.
    "http://example.com/",
    "ftp://example.com/",
    "file:///etc/passwd",
    "gopher://127.0.0.1:6379/_INFO",
    "https://user@example.com/",
    "https://user:secret@example.com/",
    "https://:secret@example.com/",
    "https://example.com@127.0.0.1/",
    "https://example.com/#part",
    "https://example.com:0/",
];

#[test]
fn what_is_not_public_is_refused() {
    for text in REFUSED {
        let refusal = ReceiverPolicy::Public.check_url(text);
        assert!(refusal.is_err(), "{text} became {refusal:?}");
    }
}

#[test]
fn what_is_no_url_is_refused() {
    let long = format!("https://example.com/{}", "x".repeat(URL_LENGTH_MAX));
    for text in [
        "",
        "example.com",
        "/hook",
        "https://",
        "https:// /",
        "https://[::1",
        &long,
    ] {
        for policy in [ReceiverPolicy::Public, ReceiverPolicy::PrivateToo] {
            assert!(policy.check_url(text).is_err(), "{text}");
        }
    }
}

#[test]
fn public_receivers_are_taken_in_their_normal_form() {
    for (text, normal) in [
        ("https://example.com", "https://example.com/"),
        ("https://Example.COM:443/a?b=c", "https://example.com/a?b=c"),
        (
            "https://hooks.example.com:8443/x/",
            "https://hooks.example.com:8443/x/",
        ),
        ("https://bücher.example/", "https://xn--bcher-kva.example/"),
        ("https://8.8.8.8/", "https://8.8.8.8/"),
        ("https://172.32.0.1/", "https://172.32.0.1/"),
        ("https://[2606:4700::1111]/", "https://[2606:4700::1111]/"),
        ("https://notlocalhost.com/", "https://notlocalhost.com/"),
        ("https://my-internal.com/", "https://my-internal.com/"),
        (
            "https://internal.example.com/",
            "https://internal.example.com/",
        ),
        (" https://example.com/\n", "https://example.com/"),
        ("https:\\\\example.com\\a", "https://example.com/a"),
    ] {
        let taken = ReceiverPolicy::Public.check_url(text);
        assert_eq!(taken.as_deref(), Ok(normal), "{text}");
    }
}

#[test]
fn private_networks_are_reached_where_that_is_chosen() {
    for text in [
        "http://10.0.0.7/hook",
        "http://127.0.0.1:9000/",
        "http://localhost:9000/",
        "https://wms.plant.local/alerts",
        "http://mes/alerts",
        "http://[fd12::7]/",
        "https://example.com/",
    ] {
        assert!(ReceiverPolicy::PrivateToo.check_url(text).is_ok(), "{text}");
    }
    for text in [
        "http://169.254.169.254/",
        "http://[::ffff:169.254.169.254]/",
        "http://[fd00:ec2::254]/",
        "http://0.0.0.0/",
        "http://224.0.0.1/",
        "ftp://10.0.0.7/",
        "http://user:secret@10.0.0.7/",
    ] {
        assert!(
            ReceiverPolicy::PrivateToo.check_url(text).is_err(),
            "{text}"
        );
    }
}

#[test]
fn refusals_teach() {
    let said = |text| {
        ReceiverPolicy::Public
            .check_url(text)
            .unwrap_err()
            .to_string()
    };
    let private = said("https://192.168.1.4/");
    assert!(
        private.starts_with("192.168.1.4 is in a private network"),
        "{private}"
    );
    for text in [
        "https://192.168.1.4/",
        "https://plc.local/",
        "http://example.com/",
    ] {
        assert!(
            said(text).contains("--webhooks-to-private-networks"),
            "{text}"
        );
    }
    assert!(!said("https://user:secret@example.com/").contains("secret"));
}

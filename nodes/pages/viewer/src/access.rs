//! Who may connect: the token in the address, the `Host` and the `Origin` of a request.
//!
//! A page of another site that is open in the user's browser can send requests to the loopback. It does not know the token,
//! its `Origin` is not on the list, and if it made its own name resolve to the loopback, the `Host` is that name.

use std::{
    io,
    net::{IpAddr, SocketAddr},
};

/// Rules of a server.
#[derive(Debug, Clone)]
pub(crate) struct Access {
    /// The address that the server listens at.
    pub(crate) address: SocketAddr,
    pub(crate) token: String,
    /// Origins besides the server's own page, such as `https://app.foxglove.dev`.
    pub(crate) allowed_origins: Vec<String>,
}

/// What a request says of its sender.
#[derive(Debug, Clone, Default)]
pub(crate) struct Credentials<'a> {
    /// The path, from `/`.
    pub(crate) path: &'a str,
    pub(crate) hosts: Vec<&'a str>,
    pub(crate) origins: Vec<&'a str>,
}

/// Why a request is refused: status, and a sentence for its sender.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Refusal(pub(crate) u16, pub(crate) String);

impl Access {
    /// The path behind the token.
    ///
    /// # Errors
    /// [`Refusal`] if the host, the origin or the token is not right.
    pub(crate) fn check<'a>(&self, credentials: &Credentials<'a>) -> Result<&'a str, Refusal> {
        let [host] = credentials.hosts[..] else { return Err(Refusal(400, "one Host is needed".into())) };
        if !self.is_own_host(host) {
            return Err(Refusal(403, "this server answers only to its own address".into()));
        }
        match credentials.origins[..] {
            // A program, or a page that the user opened by its address.
            [] => {}
            [origin] if self.is_own_origin(origin, host) => {}
            _ => {
                let origin = credentials.origins.join(", ");
                let remedy = format!("restart it with --allow-origin {origin} if you trust that page");
                return Err(Refusal(403, format!("pages of {origin} may not connect; {remedy}")));
            }
        }
        let rest = credentials.path.strip_prefix('/').unwrap_or_default();
        let (token, rest) = rest.split_once('/').unwrap_or((rest, ""));
        if !is_same(token.as_bytes(), self.token.as_bytes()) {
            return Err(Refusal(403, "the address lacks the right token; use the one that the command printed".into()));
        }
        Ok(rest)
    }

    /// Whether a `Host` names this server. A name other than `localhost` may be anybody's that resolves to this address.
    fn is_own_host(&self, host: &str) -> bool {
        let (name, port) = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((name, port)) => (name, port.strip_prefix(':')),
            None => host.split_once(':').map_or((host, None), |(name, port)| (name, Some(port))),
        };
        if port.is_none_or(|port| port != self.address.port().to_string()) {
            return false;
        }
        match name.parse::<IpAddr>() {
            Ok(ip) if self.address.ip().is_unspecified() => !ip.is_unspecified(),
            Ok(ip) => ip == self.address.ip(),
            Err(_) => name.eq_ignore_ascii_case("localhost"),
        }
    }

    fn is_own_origin(&self, origin: &str, host: &str) -> bool {
        let own = origin.strip_prefix("http://").is_some_and(|of| of.eq_ignore_ascii_case(host));
        own || self.allowed_origins.iter().any(|allowed| allowed.trim_end_matches('/').eq_ignore_ascii_case(origin))
    }
}

/// 128 random bits as hexadecimal digits.
pub(crate) fn token() -> io::Result<String> {
    let mut bits = [0; 16];
    getrandom::fill(&mut bits).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(bits.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Compares in a time that does not depend on where they differ.
fn is_same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |any, (a, b)| any | (a ^ b)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOST: &str = "127.0.0.1:8765";

    fn access(address: &str) -> Access {
        Access {
            address: address.parse().unwrap(),
            token: "0123456789abcdef".into(),
            allowed_origins: vec!["https://app.foxglove.dev".into()],
        }
    }

    fn credentials<'a>(path: &'a str, host: &'a str, origin: Option<&'a str>) -> Credentials<'a> {
        Credentials { path, hosts: vec![host], origins: origin.into_iter().collect() }
    }

    #[test]
    fn the_right_address_is_let_in_and_gives_the_path_behind_the_token() {
        let access = access(HOST);
        for (path, rest) in [("/0123456789abcdef", ""), ("/0123456789abcdef/", ""), ("/0123456789abcdef/a/b", "a/b")] {
            for origin in [None, Some("http://127.0.0.1:8765"), Some("https://app.foxglove.dev")] {
                assert_eq!(access.check(&credentials(path, HOST, origin)), Ok(rest));
            }
        }
        let by_name = credentials("/0123456789abcdef", "localhost:8765", Some("http://localhost:8765"));
        assert_eq!(access.check(&by_name), Ok(""));
    }

    #[test]
    fn every_other_host_origin_or_token_is_refused() {
        let access = access(HOST);
        let path = "/0123456789abcdef";
        for host in [
            "evil.example:8765",
            "127.0.0.1",
            "127.0.0.1:80",
            "127.0.0.2:8765",
            "127.0.0.1:8765:8765",
            "",
            "[::1]:8765",
        ] {
            assert!(access.check(&credentials(path, host, None)).is_err(), "{host}");
        }
        for origin in [
            "http://evil.example",
            "null",
            "http://127.0.0.1",
            "http://127.0.0.1:80",
            "https://127.0.0.1:8765",
            "",
            "http://localhost:8765",
            "https://app.foxglove.dev.evil.example",
            "http://app.foxglove.dev",
        ] {
            let refusal = access.check(&credentials(path, HOST, Some(origin))).unwrap_err();
            assert!(refusal.0 == 403 && refusal.1.contains("--allow-origin"), "{origin}: {refusal:?}");
        }
        for token in
            ["/", "", "/0123456789abcde", "/0123456789abcdef0", "/x", "//0123456789abcdef", "/0123456789ABCDEF"]
        {
            assert!(access.check(&credentials(token, HOST, None)).is_err(), "{token}");
        }
        let twice = Credentials { path, hosts: vec![HOST, HOST], origins: Vec::new() };
        assert!(access.check(&twice).is_err());
        let two_origins = Credentials { path, hosts: vec![HOST], origins: vec!["http://127.0.0.1:8765"; 2] };
        assert!(access.check(&two_origins).is_err());
    }

    #[test]
    fn a_server_at_all_addresses_answers_to_addresses_but_not_to_names() {
        let access = access("0.0.0.0:8765");
        let path = "/0123456789abcdef";
        assert!(access.check(&credentials(path, "192.168.1.7:8765", Some("http://192.168.1.7:8765"))).is_ok());
        assert!(access.check(&credentials(path, "evil.example:8765", None)).is_err());
    }
}

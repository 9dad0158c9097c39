//! Who may connect, and with which role: the token in the address, the `Host` and the `Origin` of a request.
//!
//! A page of another site that is open in the user's browser can send requests to the loopback. It does not know the token,
//! its `Origin` is not on the list, and if it made its own name resolve to the loopback, the `Host` is that name.

use crate::door::{Door, Role};
use std::{
    io,
    net::{IpAddr, SocketAddr},
};

/// Rules of a server.
#[derive(Debug, Clone)]
pub(crate) struct Access {
    /// The address that the server listens at.
    pub(crate) address: SocketAddr,
    /// A token for each role.
    pub(crate) tokens: [String; 3],
    /// Origins besides the server's own page, such as `https://app.foxglove.dev`, with the most that their pages may.
    pub(crate) allowed_origins: Vec<(String, Role)>,
}

/// What the sender of a request may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pass {
    pub(crate) role: Role,
    /// The origin of another site that limits the role of the token.
    limited_by: Option<String>,
}

impl Pass {
    /// # Errors
    /// A sentence for the sender: which role the door needs, and how to get it.
    pub(crate) fn admits(&self, door: Door) -> Result<(), String> {
        let (needs, role) = (door.needs(), self.role);
        if needs <= role {
            return Ok(());
        }
        Err(match &self.limited_by {
            Some(origin) => format!(
                "this needs the role {needs}, and pages of {origin} may only {role}; start again with --allow-origin {origin}={needs}"
            ),
            None => format!(
                "this needs the role {needs}, and this address may only {role}; start again with --role {needs} for one that may"
            ),
        })
    }
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
    /// The path behind the token, and what its sender may do.
    ///
    /// # Errors
    /// [`Refusal`] if the host, the origin or the token is not right.
    pub(crate) fn check<'a>(&self, credentials: &Credentials<'a>) -> Result<(&'a str, Pass), Refusal> {
        let [host] = credentials.hosts[..] else { return Err(Refusal(400, "one Host is needed".into())) };
        if !self.is_own_host(host) {
            return Err(Refusal(403, "this server answers only to its own address".into()));
        }
        let limit = match credentials.origins[..] {
            // A program, or a page that the user opened by its address.
            [] => Some(Role::Write),
            [origin] => self.limit_of(origin, host),
            _ => None,
        };
        let origin = credentials.origins.join(", ");
        let Some(limit) = limit else {
            let remedy = format!("restart it with --allow-origin {origin} if you trust that page");
            return Err(Refusal(403, format!("pages of {origin} may not connect; {remedy}")));
        };
        let rest = credentials.path.strip_prefix('/').unwrap_or_default();
        let (token, rest) = rest.split_once('/').unwrap_or((rest, ""));
        // All are compared, so that the time does not tell which is near.
        let of_role = |role: &Role| is_same(token.as_bytes(), self.token(*role).as_bytes());
        let Some(role) =
            Role::ALL.into_iter().fold(None, |found, role| if of_role(&role) { Some(role) } else { found })
        else {
            return Err(Refusal(403, "the address lacks the right token; use the one that the command printed".into()));
        };
        Ok((rest, Pass { role: role.min(limit), limited_by: (limit < role).then_some(origin) }))
    }

    pub(crate) fn token(&self, role: Role) -> &str {
        &self.tokens[role as usize]
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

    /// The most that pages of an origin may do; `None` if they may not connect.
    fn limit_of(&self, origin: &str, host: &str) -> Option<Role> {
        if origin.strip_prefix("http://").is_some_and(|of| of.eq_ignore_ascii_case(host)) {
            return Some(Role::Write);
        }
        let is_it = |allowed: &str| allowed.trim_end_matches('/').eq_ignore_ascii_case(origin);
        self.allowed_origins.iter().filter(|(allowed, _)| is_it(allowed)).map(|(_, role)| *role).max()
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
            tokens: ["abc", "abcdef", "0123456789abcdef"].map(Into::into),
            allowed_origins: vec![("https://app.foxglove.dev".into(), Role::See)],
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
                assert_eq!(access.check(&credentials(path, HOST, origin)).unwrap().0, rest);
            }
        }
        let by_name = credentials("/0123456789abcdef", "localhost:8765", Some("http://localhost:8765"));
        assert_eq!(access.check(&by_name).unwrap().1.role, Role::Write);
    }

    #[test]
    fn the_token_has_the_role_and_another_origin_limits_it() {
        let mut access = access(HOST);
        let foxglove = Some("https://app.foxglove.dev");
        let role = |access: &Access, path: &str, origin| access.check(&credentials(path, HOST, origin)).unwrap().1;
        for (path, own) in [("/abc/", Role::See), ("/abcdef/x", Role::Steer), ("/0123456789abcdef", Role::Write)] {
            assert_eq!(role(&access, path, None), Pass { role: own, limited_by: None });
            assert_eq!(role(&access, path, foxglove).role, Role::See);
        }
        let refusal = role(&access, "/0123456789abcdef", foxglove).admits(Door::Set).unwrap_err();
        assert!(refusal.contains("--allow-origin https://app.foxglove.dev=steer"), "{refusal}");
        access.allowed_origins.push(("https://app.foxglove.dev/".into(), Role::Steer));
        assert_eq!(role(&access, "/0123456789abcdef", foxglove).role, Role::Steer);
        let refusal = role(&access, "/abc", foxglove).admits(Door::Set).unwrap_err();
        assert!(refusal.contains("may only see") && refusal.contains("--role steer"), "{refusal}");
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

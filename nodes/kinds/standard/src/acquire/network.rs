//! Live sources over a network: connections, ports, clocks, losses, warnings and ends, once for all protocols.
//!
//! A [`Protocol`] is a conversation with a peer: it opens on a stream of bytes and turns each message into items on ports.
//! [`NetworkSource`] makes a source of it: it connects, and again when the connection ends, puts the items in order, reports what
//! is lost, late or missing, and stops when asked to.

mod connector;
mod inbox;
#[cfg(test)]
pub(crate) mod tests;

pub use connector::Role;
pub use inbox::StreamParams;

pub(crate) use connector::{Peer, is_waiting, listen};
pub(crate) use inbox::{Inbox, Port, PortItems};

use connector::{Connector, TRY};
use osteoflow_geometry::StampNs;
use osteoflow_node::{
    Context, Declared, DeclaredPort, Describe, Emission, NodeError, ParamError, Parameters, Source, params,
    schemars::JsonSchema, serde::Deserialize, tracing,
};
use std::{
    net::TcpStream,
    time::{Duration, Instant},
};

/// Parameters of every source over a network.
#[params]
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(default)]
pub struct NetworkParams {
    /// Time to wait for the first connection, and for the first topic if topics are advertised, before the run fails. 10: a
    /// server takes that long to start.
    #[param(10.0, 0.1..=86_400.0)]
    pub timeout_s: f64,
    /// Whether to wait for a new connection when one ends. false: the source ends with it.
    #[param(true)]
    pub reconnect: bool,
    /// Time without an item after which the source is reported as silent. 5: longer than any camera's interval.
    #[param(osteoflow_node::SILENT_AFTER.as_secs_f64(), 0.01..=86_400.0)]
    pub silent_after_s: f64,
    /// Maximum delay of one device or topic against another. A later item is replaced by an empty, and joins wait this much
    /// longer. 0: enough if the sender sends in the order of its stamps.
    #[param(0.0, 0.0..=60_000.0)]
    pub max_delay_ms: f64,
}

/// A conversation with a peer, from the opening of a connection to its end.
pub(crate) trait Protocol: Describe + Send + Sized + 'static {
    /// The kind of the source.
    const KIND: &'static str;
    /// The other side, in messages: `sender`, `server`.
    const PEER: &'static str;
    /// The state of a device or topic that the peer does not have, in messages: `has not come`.
    const MISSING: &'static str;
    /// The parameters of the kind.
    type Params: Parameters + Send;
    /// The parameters of a port.
    type PortParams: Parameters + Send;
    /// What the protocol keeps of a port beside the common state.
    type Port: Send;

    /// The parameters that every protocol has.
    fn network(params: &Self::Params) -> &NetworkParams;

    /// The peer that the parameters name.
    ///
    /// # Errors
    /// The address is none of this protocol.
    fn peer(params: &Self::Params) -> Result<Peer, ParamError>;

    /// The ports that the graph declares.
    ///
    /// # Errors
    /// A port that cannot be read, or two that read the same.
    fn ports(declared: &[DeclaredPort]) -> Result<Vec<Port<Self::Port>>, ParamError>;

    /// Opens a conversation on a connection, whose reads return within a fraction of a second.
    ///
    /// # Errors
    /// [`OpenError`] if the other side does not take part.
    fn open(stream: TcpStream, params: &Self::Params, ctx: &Context) -> Result<Self, OpenError>;

    /// Waits briefly for the next message and offers it to the ports.
    ///
    /// # Errors
    /// What makes the source fail.
    fn receive(&mut self, inbox: &mut Inbox<Self::Port>, ctx: &mut Context) -> Result<Incoming, NodeError>;

    /// As [`Source::is_timed`]. A message without a stamp has the time of its arrival.
    fn is_timed(_port: &DeclaredPort) -> bool {
        true
    }

    /// What is wrong if nothing that a port reads was announced in the whole timeout; `None` if that is no fault.
    fn is_useless(&self, _inbox: &Inbox<Self::Port>) -> Option<String> {
        None
    }

    /// What came from a device or topic of a port in place of what the port reads, and the remedy; `None` if nothing did.
    fn instead(&self, _port: &Port<Self::Port>) -> Option<String> {
        None
    }

    /// Devices or topics that no port reads, to be listed once; empty where they were listed or there are none.
    fn unread(&self) -> Vec<String> {
        Vec::new()
    }

    /// What the peer has beside the missing devices or topics, in messages.
    fn others(&self) -> String;
}

/// Why a conversation could not be opened.
pub(crate) enum OpenError {
    /// The peer may not be ready; it is tried again.
    NotReady(String),
    /// The peer refuses this side.
    Refused(String),
}

/// The outcome of one wait for a message.
pub(crate) enum Incoming {
    /// A message, which was offered to the ports.
    Message,
    /// Bytes that are no message.
    Damage(String),
    /// Nothing yet.
    Nothing,
    /// The connection has ended, for this reason; `is_orderly` if a peer ends its streams like this.
    End { reason: String, is_orderly: bool },
}

/// The source of a protocol.
pub(crate) struct NetworkSource<P: Protocol> {
    params: P::Params,
    peer: Peer,
    /// From the first call on.
    run: Option<Run<P>>,
}

/// The state of a source that runs.
struct Run<P: Protocol> {
    connector: Connector,
    conversation: Option<P>,
    inbox: Inbox<P::Port>,
    /// When the conversation was opened.
    opened: Instant,
    /// When the first message came.
    first: Option<Instant>,
    has_checked_missing: bool,
    /// Whether the connection has ended for good.
    is_over: bool,
}

impl<P: Protocol> Describe for NetworkSource<P> {
    const DOC: &'static str = P::DOC;
    const EXAMPLE: &'static str = P::EXAMPLE;
    const LITERATURE: &'static [&'static str] = P::LITERATURE;
}

impl<P: Protocol> Source for NetworkSource<P> {
    const KIND: &'static str = P::KIND;
    const LIVE: bool = true;
    type Params = P::Params;
    type Outputs = Declared<P::PortParams>;

    fn new(params: P::Params) -> Result<Self, ParamError> {
        Ok(Self { peer: P::peer(&params)?, params, run: None })
    }

    fn check_ports(ports: &[DeclaredPort]) -> Result<(), ParamError> {
        P::ports(ports).map(drop)
    }

    fn is_timed(&self, port: &DeclaredPort) -> bool {
        P::is_timed(port)
    }

    fn max_delay_ns(&self) -> StampNs {
        (P::network(&self.params).max_delay_ms * 1e6).round() as StampNs
    }

    fn silent_after(&self) -> Duration {
        Duration::from_secs_f64(P::network(&self.params).silent_after_s)
    }

    fn next(&mut self, ctx: &mut Context) -> Result<Option<Self::Outputs>, NodeError> {
        let run = match &mut self.run {
            Some(run) => run,
            None => self.run.insert(Run::new(&self.peer, ctx)?),
        };
        loop {
            if let Some(event) = run.inbox.pop() {
                ctx.set_stamp_ns(event.stamp_ns);
                return Ok(Some(Declared::one(event.port, event.body)));
            }
            if run.is_over || ctx.cancelled() {
                return Ok(None);
            }
            let was_open = run.conversation.is_some();
            run.step(&self.params, ctx)?;
            let has_ended = was_open && run.conversation.is_none();
            if has_ended && run.inbox.is_empty() && !run.is_over {
                // An answer without items passes the warning on now.
                return Ok(Some(Declared::one(0, Emission::Silent)));
            }
        }
    }
}

impl<P: Protocol> Run<P> {
    fn new(peer: &Peer, ctx: &Context) -> Result<Self, NodeError> {
        Ok(Self {
            connector: Connector::new(peer.clone()),
            conversation: None,
            inbox: Inbox::new(P::ports(&ctx.declared())?),
            opened: Instant::now(),
            first: None,
            has_checked_missing: false,
            is_over: false,
        })
    }

    /// Waits briefly for a connection or a message.
    fn step(&mut self, params: &P::Params, ctx: &mut Context) -> Result<(), NodeError> {
        if let Some((stream, peer)) = self.connector.stream(self.conversation.is_some(), ctx)? {
            self.open(stream, &peer.to_string(), params, ctx)?;
        }
        for peer in self.connector.turned_away.drain(..) {
            let message = format!("{peer} connected while another {} was, and was turned away", P::PEER);
            self.inbox.warn("turned away", message, ctx);
        }
        if let Some(conversation) = &mut self.conversation {
            match conversation.receive(&mut self.inbox, ctx)? {
                Incoming::Message => {
                    self.first.get_or_insert_with(Instant::now);
                    self.inbox.flush();
                }
                Incoming::Damage(damage) => self.inbox.warn("damage", damage, ctx),
                Incoming::Nothing => {}
                Incoming::End { reason, is_orderly } => self.end(&reason, is_orderly, P::network(params), ctx)?,
            }
        }
        if let Some(fault) = self.inbox.take_fault() {
            return Err(NodeError::new(fault));
        }
        self.check(P::network(params), ctx)
    }

    fn open(&mut self, stream: TcpStream, peer: &str, params: &P::Params, ctx: &mut Context) -> Result<(), NodeError> {
        let began = Instant::now();
        match P::open(stream, params, ctx) {
            Ok(conversation) => {
                tracing::info!(peer, "connected");
                if self.first.is_some() {
                    ctx.warn(format!("connected again, with {peer}"));
                }
                (self.conversation, self.opened) = (Some(conversation), Instant::now());
                return Ok(());
            }
            Err(OpenError::NotReady(why)) => self.connector.why = why,
            Err(OpenError::Refused(why)) if self.first.is_none() => {
                return Err(NodeError::new(format!("{} refuses the connection: {why}", self.connector.peer.shown)));
            }
            Err(OpenError::Refused(why)) => {
                self.inbox.warn("refused", format!("the {} refuses the connection: {why}", P::PEER), ctx);
            }
        }
        ctx.wait_until(began + TRY);
        Ok(())
    }

    fn end(
        &mut self,
        reason: &str,
        is_orderly: bool,
        params: &NetworkParams,
        ctx: &mut Context,
    ) -> Result<(), NodeError> {
        if params.reconnect {
            ctx.warn(format!("{reason}; waiting for the {} again", P::PEER));
            self.inbox.lose(reason, |_| true);
        } else {
            if !is_orderly {
                ctx.warn(reason);
            }
            self.check_missing(ctx)?;
            self.is_over = true;
        }
        self.conversation = None;
        self.connector.restart();
        Ok(())
    }

    fn check(&mut self, params: &NetworkParams, ctx: &mut Context) -> Result<(), NodeError> {
        let is_late = |since: Instant| since.elapsed().as_secs_f64() > params.timeout_s;
        match &self.conversation {
            None if self.first.is_none() && is_late(self.connector.since) => {
                return Err(NodeError::new(self.connector.no_connection(P::PEER, params.timeout_s)));
            }
            Some(conversation) if is_late(self.opened) => {
                if let Some(fault) = conversation.is_useless(&self.inbox) {
                    return Err(NodeError::new(fault));
                }
            }
            _ => {}
        }
        if self.first.is_some_and(|first| first.elapsed().as_secs_f64() > params.silent_after_s) {
            self.check_missing(ctx)?;
        }
        Ok(())
    }

    /// Reports, once, the devices or topics of ports that the peer does not have, and those that no port reads; fails if a port
    /// names one that sends something else.
    fn check_missing(&mut self, ctx: &mut Context) -> Result<(), NodeError> {
        let Some(conversation) = self.conversation.as_ref().filter(|_| !self.has_checked_missing) else {
            return Ok(());
        };
        self.has_checked_missing = true;
        let faults: Vec<String> = self.inbox.ports.iter().filter_map(|port| conversation.instead(port)).collect();
        if !faults.is_empty() {
            return Err(NodeError::new(faults.join("; ")));
        }
        let mut is_listed = false;
        for port in self.inbox.ports.iter().filter(|port| port.at_first.is_empty()) {
            let missing = port.missing();
            if !missing.is_empty() {
                let (name, others) = (&port.name, conversation.others());
                ctx.warn(format!("port \"{name}\": {} {}; {others}", missing.join(", "), P::MISSING));
                is_listed = true;
            }
        }
        let unread = conversation.unread();
        if !is_listed && !unread.is_empty() {
            ctx.warn(format!("no port reads {}", unread.join(", ")));
        }
        Ok(())
    }
}

//! Everything that the server answers or takes, each with the role that it needs.

use std::{fmt, str::FromStr};

/// What an address lets its holder do. Each role may do what those before it may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// See what is shown.
    See,
    /// Play a recording; set numbers, switches, words of a choice and kinds of the graph.
    Steer,
    /// Set texts such as paths below the graph's folder; save picks, regions and the graph file.
    Write,
}

impl Role {
    pub(crate) const ALL: [Self; 3] = [Self::See, Self::Steer, Self::Write];

    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::See => "see",
            Self::Steer => "steer",
            Self::Write => "write",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl FromStr for Role {
    type Err = &'static str;

    fn from_str(word: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|role| role.word() == word).ok_or("a role is see, steer or write")
    }
}

/// The enum, and the list of its values: a door cannot be left out of it.
macro_rules! doors {
    ($($(#[$words:meta])* $door:ident,)*) => {
        /// What the server answers or takes.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Door { $($(#[$words])* $door,)* }

        impl Door {
            /// All doors.
            pub const ALL: &[Self] = &[$(Self::$door,)*];
        }
    };
}

doors! {
    /// The page, its scripts and its style.
    Page,
    /// Where picks are saved, and the plan that is known.
    Picks,
    /// The stream to viewers: its channels, and messages that need no reply.
    Stream,
    /// Begin or end a subscription of the stream.
    Subscribe,
    /// The values of parameters.
    GetParameters,
    /// Set parameters by the protocol.
    SetParameters,
    /// Play, stop, or go to a time of a recording, for all who see it.
    Playback,
    /// Set keys of the graph.
    Set,
    /// Take all changes back.
    Revert,
    /// Write the changes into the graph file.
    Write,
    /// Save a region, and let a crop use it.
    Region,
    /// Save a picked plan.
    SavePlan,
    /// Save picked pairs.
    SavePairs,
}

impl Door {
    /// The least role that may pass.
    pub const fn needs(self) -> Role {
        match self {
            Self::Page | Self::Picks | Self::Stream | Self::Subscribe | Self::GetParameters => Role::See,
            Self::SetParameters | Self::Playback | Self::Set | Self::Revert => Role::Steer,
            Self::Write | Self::Region | Self::SavePlan | Self::SavePairs => Role::Write,
        }
    }

    /// The path of its requests behind the token, of those that are posted.
    pub const fn action(self) -> Option<&'static str> {
        match self {
            Self::Set => Some("set"),
            Self::Revert => Some("revert"),
            Self::Write => Some("write"),
            Self::Region => Some("region"),
            Self::SavePlan => Some("save/plan"),
            Self::SavePairs => Some("save/pairs"),
            Self::Page | Self::Picks | Self::Stream | Self::Subscribe => None,
            Self::GetParameters | Self::SetParameters | Self::Playback => None,
        }
    }

    /// Its name as a service of the protocol. What is picked is posted only.
    pub(crate) fn service(self) -> Option<&'static str> {
        self.action().filter(|action| !action.contains('/'))
    }

    /// The door of a request.
    pub(crate) fn of_request(method: &str, path: &str) -> Option<Self> {
        match (method, path) {
            ("GET", "picks") => Some(Self::Picks),
            ("GET", _) => Some(Self::Page),
            _ => Self::ALL.iter().copied().find(|door| door.action() == Some(path)),
        }
    }
}

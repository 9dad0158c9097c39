use super::Size;

/// Why a sample of a marker is left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cause {
    /// The kind of fault.
    pub kind: Kind,
    /// By how much the sample is off those around it, mm.
    pub mm: f64,
    /// By how much it is turned against them, rad.
    pub rad: f64,
}

/// Kinds of faults of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The identity, as some trackers give it for a tool that they do not see.
    Identity,
    /// Off the samples before and after it.
    Outlier,
    /// In a time in which too many samples disagree.
    Ambiguous,
    /// After a motion that no hand makes.
    Jump,
    /// At the end: off the samples before it, with none after it.
    Unconfirmed,
}

impl Kind {
    /// The name of the rule that finds it.
    pub fn rule(self) -> &'static str {
        match self {
            Self::Identity => "marker_identity",
            Self::Outlier => "marker_outlier",
            Self::Ambiguous => "marker_ambiguous",
            Self::Jump => "marker_jump",
            Self::Unconfirmed => "marker_unconfirmed",
        }
    }
}

impl Cause {
    pub(super) fn new(kind: Kind, size: Size) -> Self {
        Self { kind, mm: size.mm, rad: size.rad }
    }

    pub(super) fn size(&self) -> Size {
        Size { mm: self.mm, rad: self.rad }
    }

    /// The cause in words, with its size.
    pub fn words(&self) -> String {
        let size = format!("{:.1} mm and {:.1} degrees", self.mm, self.rad.to_degrees());
        match self.kind {
            Kind::Identity => "it is the identity, as some trackers write for a tool that they do not see".into(),
            Kind::Outlier => format!("it is {size} off the poses before and after it"),
            Kind::Ambiguous => {
                format!(
                    "the poses around it disagree by {size}, as of a marker whose attitude flips, and none says which are right"
                )
            }
            Kind::Jump => format!("the marker moved by {size}, faster than a hand moves it"),
            Kind::Unconfirmed => format!("it is {size} off the poses before it, and no later ones confirm it"),
        }
    }
}

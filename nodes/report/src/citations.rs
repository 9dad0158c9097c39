//! The literature of the nodes that were used, as BibTeX.

use crate::html::Page;
use osteoflow_node::Registry;

/// A work, with the words by which nodes name it.
struct Work {
    /// What a node's literature begins with.
    named: &'static str,
    bibtex: &'static str,
}

/// What nodes say of the paper whose method the graphs follow: `section 2.3 of the paper`.
const THE_PAPER: &str = "of the paper";

const WORKS: &[Work] = &[
    Work {
        named: "Bendels, Schnabel & Klein 2006",
        bibtex: "@article{bendels2006,
  author  = {Bendels, Gerhard H. and Schnabel, Ruwen and Klein, Reinhard},
  title   = {Detecting Holes in Point Set Surfaces},
  journal = {Journal of WSCG},
  volume  = {14},
  pages   = {89--96},
  year    = {2006}
}",
    },
    Work {
        named: "Besl & McKay 1992",
        bibtex: "@article{besl1992,
  author  = {Besl, Paul J. and McKay, Neil D.},
  title   = {A Method for Registration of {3-D} Shapes},
  journal = {IEEE Transactions on Pattern Analysis and Machine Intelligence},
  volume  = {14},
  number  = {2},
  pages   = {239--256},
  year    = {1992},
  doi     = {10.1109/34.121791}
}",
    },
    Work {
        named: "Chen & Medioni 1992",
        bibtex: "@article{chen1992,
  author  = {Chen, Yang and Medioni, G{\\'e}rard},
  title   = {Object Modelling by Registration of Multiple Range Images},
  journal = {Image and Vision Computing},
  volume  = {10},
  number  = {3},
  pages   = {145--155},
  year    = {1992},
  doi     = {10.1016/0262-8856(92)90066-C}
}",
    },
    Work {
        named: "Cignoni, Rocchini & Scopigno 1998",
        bibtex: "@article{cignoni1998,
  author  = {Cignoni, Paolo and Rocchini, Claudio and Scopigno, Roberto},
  title   = {Metro: Measuring Error on Simplified Surfaces},
  journal = {Computer Graphics Forum},
  volume  = {17},
  number  = {2},
  pages   = {167--174},
  year    = {1998},
  doi     = {10.1111/1467-8659.00236}
}",
    },
    Work {
        named: "Fitzpatrick 2009",
        bibtex: "@inproceedings{fitzpatrick2009,
  author    = {Fitzpatrick, J. Michael},
  title     = {Fiducial Registration Error and Target Registration Error Are Uncorrelated},
  booktitle = {Medical Imaging 2009: Visualization, Image-Guided Procedures, and Modeling},
  series    = {Proceedings of SPIE},
  volume    = {7261},
  pages     = {726102},
  year      = {2009},
  doi       = {10.1117/12.813601}
}",
    },
    Work {
        named: "Hoppe et al. 1992",
        bibtex: "@inproceedings{hoppe1992,
  author    = {Hoppe, Hugues and DeRose, Tony and Duchamp, Tom and McDonald, John and Stuetzle, Werner},
  title     = {Surface Reconstruction from Unorganized Points},
  booktitle = {Proceedings of SIGGRAPH '92},
  pages     = {71--78},
  year      = {1992},
  doi       = {10.1145/133994.134011}
}",
    },
    Work {
        named: "Kabsch 1976",
        bibtex: "@article{kabsch1976,
  author  = {Kabsch, Wolfgang},
  title   = {A Solution for the Best Rotation to Relate Two Sets of Vectors},
  journal = {Acta Crystallographica Section A},
  volume  = {32},
  number  = {5},
  pages   = {922--923},
  year    = {1976},
  doi     = {10.1107/S0567739476001873}
}",
    },
    Work {
        named: "Markley et al. 2007",
        bibtex: "@article{markley2007,
  author  = {Markley, F. Landis and Cheng, Yang and Crassidis, John L. and Oshman, Yaakov},
  title   = {Averaging Quaternions},
  journal = {Journal of Guidance, Control, and Dynamics},
  volume  = {30},
  number  = {4},
  pages   = {1193--1197},
  year    = {2007},
  doi     = {10.2514/1.28949}
}",
    },
    Work {
        named: "Pottmann, Huang, Yang & Hu 2006",
        bibtex: "@article{pottmann2006,
  author  = {Pottmann, Helmut and Huang, Qi-Xing and Yang, Yong-Liang and Hu, Shi-Min},
  title   = {Geometry and Convergence Analysis of Algorithms for Registration of {3D} Shapes},
  journal = {International Journal of Computer Vision},
  volume  = {67},
  number  = {3},
  pages   = {277--296},
  year    = {2006},
  doi     = {10.1007/s11263-006-5167-2}
}",
    },
    Work {
        named: "Rusinkiewicz & Levoy 2001",
        bibtex: "@inproceedings{rusinkiewicz2001,
  author    = {Rusinkiewicz, Szymon and Levoy, Marc},
  title     = {Efficient Variants of the {ICP} Algorithm},
  booktitle = {Proceedings of the Third International Conference on {3-D} Digital Imaging and Modeling},
  pages     = {145--152},
  year      = {2001},
  doi       = {10.1109/IM.2001.924423}
}",
    },
    Work {
        named: "Rusinkiewicz 2019",
        bibtex: "@article{rusinkiewicz2019,
  author  = {Rusinkiewicz, Szymon},
  title   = {A Symmetric Objective Function for {ICP}},
  journal = {ACM Transactions on Graphics},
  volume  = {38},
  number  = {4},
  year    = {2019},
  doi     = {10.1145/3306346.3323037}
}",
    },
    Work {
        named: "Segal, Haehnel & Thrun 2009",
        bibtex: "@inproceedings{segal2009,
  author    = {Segal, Aleksandr V. and Haehnel, Dirk and Thrun, Sebastian},
  title     = {Generalized-{ICP}},
  booktitle = {Robotics: Science and Systems {V}},
  year      = {2009},
  doi       = {10.15607/RSS.2009.V.021}
}",
    },
    Work {
        named: "Sutherland & Hodgman 1974",
        bibtex: "@article{sutherland1974,
  author  = {Sutherland, Ivan E. and Hodgman, Gary W.},
  title   = {Reentrant Polygon Clipping},
  journal = {Communications of the ACM},
  volume  = {17},
  number  = {1},
  pages   = {32--42},
  year    = {1974},
  doi     = {10.1145/360767.360802}
}",
    },
    Work {
        named: "Yaniv 2015",
        bibtex: "@inproceedings{yaniv2015,
  author    = {Yaniv, Ziv},
  title     = {Which Pivot Calibration?},
  booktitle = {Medical Imaging 2015: Image-Guided Procedures, Robotic Interventions, and Modeling},
  series    = {Proceedings of SPIE},
  volume    = {9415},
  pages     = {941527},
  year      = {2015},
  doi       = {10.1117/12.2081348}
}",
    },
];

/// The program itself, which every report cites.
fn program(version: &str) -> String {
    format!(
        "@software{{osteoflow,\n  author  = {{{{The Osteoflow developers}}}},\n  title   = {{Osteoflow: surface registration \
         experiments for computer-assisted surgery, run as graphs of nodes}},\n  version = {{{version}}},\n  url     = \
         {{https://github.com/osteoflow/osteoflow}}\n}}"
    )
}

/// The work that a node's literature names, without the place in it; `None` if it is not known here.
fn work(literature: &str) -> Option<&'static Work> {
    WORKS.iter().find(|work| literature.starts_with(work.named))
}

/// Writes the references of these kinds, and gives them as BibTeX.
pub(crate) fn section(page: &mut Page, kinds: &[&str], registry: &Registry) -> String {
    let mut used: Vec<(&str, Vec<&str>)> = Vec::new();
    let (mut paper, mut unknown) = (false, Vec::new());
    for kind in kinds {
        let literature = registry.kind(kind).map_or(&[][..], |kind| kind.description.literature);
        for source in literature {
            match work(source) {
                Some(work) => match used.iter_mut().find(|(bibtex, _)| *bibtex == work.bibtex) {
                    Some((_, by)) if by.contains(kind) => {}
                    Some((_, by)) => by.push(kind),
                    None => used.push((work.bibtex, vec![kind])),
                },
                None if source.contains(THE_PAPER) => paper = true,
                None => unknown.push(format!("{source} (named by {kind})")),
            }
        }
    }
    used.sort();
    let mut entries = vec![program(env!("CARGO_PKG_VERSION"))];
    entries.extend(used.iter().map(|(bibtex, _)| (*bibtex).to_owned()));
    page.text("The literature that the nodes of this graph name; citations.bib holds the same entries.");
    if paper {
        page.text(
            "Some nodes follow \u{201c}the paper\u{201d}, the published method of contactless registration that the shipped \
             graphs rebuild; this program holds no entry of it, so add yours.",
        );
    }
    if !unknown.is_empty() {
        page.text(&format!("Named by nodes, without an entry here: {}.", unknown.join("; ")));
    }
    let text = entries.join("\n\n") + "\n";
    page.code(&text);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_work_that_a_built_in_node_names_has_an_entry() {
        let registry = osteoflow_standard::registry();
        let mut n = 0;
        for kind in registry.kinds() {
            for source in kind.description.literature {
                let known = work(source).is_some() || source.contains(THE_PAPER);
                assert!(known, "{} names \"{source}\"; give it an entry in citations.rs", kind.description.kind);
                n += 1;
            }
        }
        assert!(n > 10);
    }

    #[test]
    fn entries_are_whole_and_their_keys_are_their_own() {
        let mut keys = Vec::new();
        for work in WORKS {
            let (open, close) = (work.bibtex.matches('{').count(), work.bibtex.matches('}').count());
            assert_eq!(open, close, "{}", work.bibtex);
            for field in ["author", "title", "year"] {
                assert!(work.bibtex.contains(&format!("  {field} ")), "{} lacks {field}", work.named);
            }
            let key = work.bibtex.split(['{', ',']).nth(1).unwrap();
            assert!(!keys.contains(&key), "{key} twice");
            keys.push(key);
        }
    }
}

//! Which light: few by their power, many by what they may do to the point in hand.

use super::alias::AliasTable;
use super::list::Listed;
use super::tree::LightTree;
use glam::Vec3;

/// From this many lights on a tree chooses. Measured by variance times time in a box lit by square lamps, two triangles each:
/// with one lamp the tree costs 15 % and gains nothing; with 2, 8 and 128 lamps it gains 25, 50 and 45 %.
const TREE_FROM: usize = 4;

/// Up to this many lights one random number does for the choice and for a coordinate on the light: it keeps about 18 of its 24
/// bits, and lights and points on them are well distributed together.
const FEW: usize = 64;

/// Stands for "not in the tree".
const NONE: u32 = u32::MAX;

/// Probabilities of lights.
pub enum Choice {
    /// In proportion to power.
    Power(AliasTable),
    /// By importance at the point; what is infinitely far is beside the tree.
    Importance(Importance),
}

/// A tree over finite lights, and infinite ones.
pub struct Importance {
    tree: LightTree,
    /// The lights of the tree's leaves.
    finite: Vec<u32>,
    /// The tree's leaf of each light, or [`NONE`].
    leaf_of: Vec<u32>,
    /// Lights without a place, each as likely as the whole tree.
    infinite: Vec<u32>,
}

impl Choice {
    /// Probabilities for these lights. Those without power are never chosen.
    pub fn new(listed: &[Listed]) -> Self {
        let shines = |i: &u32| listed[*i as usize].power > 0.0;
        let (finite, infinite): (Vec<u32>, Vec<u32>) =
            (0..listed.len() as u32).filter(shines).partition(|&i| listed[i as usize].reach.is_some());
        if finite.len() < TREE_FROM {
            return Self::Power(AliasTable::new(&listed.iter().map(|l| l.power).collect::<Vec<_>>()));
        }
        let reaches: Vec<_> = finite.iter().filter_map(|&i| listed[i as usize].reach).collect();
        let mut leaf_of = vec![NONE; listed.len()];
        finite.iter().enumerate().for_each(|(leaf, &light)| leaf_of[light as usize] = leaf as u32);
        Self::Importance(Importance { tree: LightTree::new(&reaches), finite, leaf_of, infinite })
    }

    /// So few lights that enough of a random number is left for a point on the one that it has chosen.
    pub fn leaves_much(&self) -> bool {
        match self {
            Self::Power(_) => true,
            Self::Importance(Importance { finite, infinite, .. }) => finite.len() + infinite.len() <= FEW,
        }
    }

    /// A light for a surface point and its probability; none where none can shine. What is left of `u` is a fresh number.
    #[inline(always)]
    pub fn sample(&self, u: &mut f32, position: Vec3, normal: Vec3) -> Option<(u32, f32)> {
        match self {
            Self::Power(table) => table.sample(u),
            Self::Importance(Importance { tree, finite, infinite, .. }) => {
                let kinds = infinite.len() + 1;
                let at = *u * kinds as f32;
                let kind = (at as usize).min(kinds - 1);
                *u = at - kind as f32;
                let probability = 1.0 / kinds as f32;
                if kind > 0 {
                    return Some((infinite[kind - 1], probability));
                }
                let (leaf, among) = tree.sample(u, position, normal)?;
                Some((finite[leaf as usize], probability * among))
            }
        }
    }

    /// The probability of a light at a surface point.
    #[inline(always)]
    pub fn probability(&self, light: u32, position: Vec3, normal: Vec3) -> f32 {
        match self {
            Self::Power(table) => table.probability(light),
            Self::Importance(Importance { tree, leaf_of, infinite, .. }) => {
                let probability = 1.0 / (infinite.len() + 1) as f32;
                match leaf_of[light as usize] {
                    NONE if infinite.contains(&light) => probability,
                    NONE => 0.0,
                    leaf => probability * tree.probability(leaf, position, normal),
                }
            }
        }
    }
}

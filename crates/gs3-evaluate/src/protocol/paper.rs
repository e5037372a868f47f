//! The columns of the three tables of "3DGS³: Joint Super Sampling and Frame Interpolation for Real-Time Large-Scale
//! 3DGS Rendering": methods compared, the same with each acceleration of rasterization, and parts left out.

use std::path::Path;
use std::sync::Arc;

use gs3::Culling;
use gs3_scene::Scene;
use serde::{Deserialize, Serialize};

use super::{EvaluateError, Event, Failure, Protocol, ProtocolFacts, ResultRow, Results};
use crate::methods::{MethodSpec, check_weights};

/// The protocol of the paper on one scene and path; its `methods` and `culling` are not read.
#[derive(Clone, Debug)]
pub struct Paper {
    /// Scene, path, frames and sizes.
    pub protocol: Protocol,
    /// The scene after simplification by importance.
    pub simplified: Option<Arc<Scene>>,
}

/// A table of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Table {
    /// Methods against each other.
    Comparison,
    /// Native rendering and gs3 with accelerations of rasterization.
    Acceleration,
    /// gs3 without some of its parts.
    Ablation,
}

/// One row of a table and subset of frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperRow {
    /// The table.
    pub table: Table,
    /// The acceleration, or what is left out; empty for methods compared.
    pub variant: String,
    /// The figures; speed-ups are over native rendering with the same acceleration.
    #[serde(flatten)]
    pub row: ResultRow,
    /// [`ResultRow::displayed_fps`] over the speed of native rendering as 3DGS publishes it (`plain`, of the whole
    /// scene), measured beside it.
    pub speedup_over_plain: Option<f64>,
}

/// A row of the paper that has no figures here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Absent {
    /// The table.
    pub table: Table,
    /// The row.
    pub row: String,
    /// Why it is absent.
    pub reason: String,
}

/// What the paper's protocol found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PaperResults {
    /// Facts of the run of compared methods; the others differ in tile culling or scene only.
    pub protocol: ProtocolFacts,
    /// One row per table row and subset.
    pub results: Vec<PaperRow>,
    /// Rows without figures.
    pub absent: Vec<Absent>,
    /// Methods that failed.
    pub failures: Vec<Failure>,
}

/// What the paper compares, as far as it can be had; interpolation by repetition and blending for all that have none.
const COMPARED: [&str; 12] = [
    "native",
    "bicubic+repeat",
    "bicubic+blend",
    "lanczos+blend",
    "fsr1+blend",
    "bicubic+warp",
    "spline+warp",
    "hermite+warp",
    "history+blend",
    "analytic",
    "bicubic@kerbl+blend",
    "analytic@kerbl",
];

/// Published networks, compared where their weights are given.
const NETWORKS: [&str; 3] = ["span+blend", "safmn+blend", "rt4ksr+blend"];

/// Published networks trained by gs3's trainer on its own LR frames, compared where their weights are there.
const TRAINED: [&str; 3] = ["ecbsr_trained+blend", "rt4ksr_trained+blend", "ninasr_trained+blend"];

/// gs3 with learning, compared where its weights are there.
const LEARNED: [&str; 3] = ["fast", "balanced", "high"];

/// The complete method: parts of it are left out, and it is accelerated.
const WHOLE: &str = "analytic";

/// What is left out, and the method without it.
const ABLATIONS: [(&str, &str); 7] = [
    ("nothing", WHOLE),
    ("gradients", "history_gradientless+warp"),
    ("jitter", "history_centered+warp"),
    ("history", "hermite+warp"),
    ("history and gradients", "bicubic+warp"),
    ("interpolation", "history+repeat"),
    ("matched dilation (0.3 instead)", "analytic@kerbl"),
];

/// What is left out of [`LEARNED`] in the middle tier.
const LEARNED_ABLATIONS: [(&str, &str); 4] = [
    ("nothing", "balanced_ss+balanced"),
    ("learned interpolation", "balanced"),
    ("learned super sampling", "overscan+balanced"),
    ("matched dilation (0.3 instead)", "balanced@kerbl"),
];

/// Accelerations by tile culling, `plain` being 3DGS as published.
const CULLINGS: [(&str, Culling); 4] = [
    (PLAIN, Culling::Aabb3Sigma),
    ("AdR", Culling::Adr),
    ("SnugBox", Culling::SnugBox),
    (EXACT, Culling::AccuTile),
];
const PLAIN: &str = "plain";
const EXACT: &str = "AccuTile";
const SIMPLIFIED: &str = "AccuTile, simplified";

impl Paper {
    /// Runs all tables; `folder` keeps what is finished.
    ///
    /// # Errors
    /// As [`Protocol::run`].
    pub fn run(
        &self,
        folder: &Path,
        watch: &mut dyn FnMut(Event<'_>),
    ) -> Result<PaperResults, EvaluateError> {
        let networks = if self.protocol.weights.is_some() { &NETWORKS[..] } else { &[] };
        let learned = TRAINED.into_iter().chain(LEARNED).filter(|name| self.lack(name).is_none());
        let parts = LEARNED_ABLATIONS.into_iter().filter(|(_, name)| self.lack(name).is_none());
        let ablations = ABLATIONS.into_iter().chain(parts).map(|(_, name)| name);
        let names = COMPARED.iter().chain(networks).copied().chain(learned).chain(ablations);
        let compared = self.run_one(folder, EXACT, Culling::AccuTile, &self.protocol.scene, names, watch)?;
        let mut accelerated = Vec::new();
        for (name, culling) in CULLINGS {
            if name != EXACT {
                let scene = &self.protocol.scene;
                accelerated
                    .push((name, self.run_one(folder, name, culling, scene, [WHOLE].into_iter(), watch)?));
            }
        }
        if let Some(scene) = &self.simplified {
            let names = [WHOLE].into_iter();
            let results = self.run_one(folder, "simplified", Culling::AccuTile, scene, names, watch)?;
            accelerated.push((SIMPLIFIED, results));
        }
        let at = accelerated.len() - usize::from(self.simplified.is_some());
        accelerated.insert(at, (EXACT, compared.clone()));
        Ok(self.tables(&compared, &accelerated))
    }

    fn run_one<'a>(
        &self,
        folder: &Path,
        name: &str,
        culling: Culling,
        scene: &Arc<Scene>,
        methods: impl Iterator<Item = &'a str>,
        watch: &mut dyn FnMut(Event<'_>),
    ) -> Result<Results, EvaluateError> {
        let methods: Result<Vec<MethodSpec>, _> = methods.map(str::parse).collect();
        let protocol = Protocol {
            scene: Arc::clone(scene),
            culling,
            beside: Culling::Aabb3Sigma,
            // The names are constants of this module, and a test parses them.
            methods: methods.unwrap_or_default(),
            ..self.protocol.clone()
        };
        protocol.run(&folder.join(name), watch)
    }

    fn tables(&self, compared: &Results, accelerated: &[(&str, Results)]) -> PaperResults {
        let plain = (accelerated.iter().find(|(name, _)| *name == PLAIN))
            .and_then(|(_, results)| speed(results, "native"));
        let mut results = Vec::new();
        let mut add = |table, variant: &str, from: &Results, method: &str| {
            results.extend(from.results.iter().filter(|row| row.method == method).map(|row| PaperRow {
                table,
                variant: variant.into(),
                row: row.clone(),
                speedup_over_plain: speed(from, method).zip(plain).map(|(speed, plain)| speed / plain),
            }));
        };
        for method in COMPARED.iter().chain(&NETWORKS).chain(&TRAINED).chain(&LEARNED) {
            add(Table::Comparison, "", compared, method);
        }
        for (name, results) in accelerated {
            add(Table::Acceleration, name, results, "native");
            add(Table::Acceleration, name, results, WHOLE);
        }
        for (part, method) in ABLATIONS.into_iter().chain(LEARNED_ABLATIONS) {
            add(Table::Ablation, part, compared, method);
        }
        let runs = accelerated.iter().filter(|(name, _)| *name != EXACT).map(|(_, results)| results);
        let failures = std::iter::once(compared).chain(runs).flat_map(|r| r.failures.clone()).collect();
        let protocol = compared.protocol.clone();
        PaperResults { protocol, results, absent: self.absent(), failures }
    }

    /// Which weights a method lacks, if it lacks some.
    fn lack(&self, method: &str) -> Option<String> {
        let Protocol { scale, weights, .. } = &self.protocol;
        // The names are constants of this module, and a test parses them.
        let spec = method.parse::<MethodSpec>().ok()?;
        check_weights(&[spec], *scale, weights.as_deref()).err().map(|error| error.to_string())
    }

    fn absent(&self) -> Vec<Absent> {
        let absent =
            |table, row: &str, reason: &str| Absent { table, row: row.into(), reason: reason.into() };
        let unpublished = "no usable weights are published";
        let mut rows = vec![
            absent(Table::Comparison, "NinaSR-B1, ECBSR as published", unpublished),
            absent(Table::Comparison, "FLAVR, RIFE, IFRNet, InterpAny, GIMM-VFI", unpublished),
            absent(
                Table::Ablation,
                "networks trained without gradients, recurrence or jitter",
                "each needs weights of its own",
            ),
        ];
        let learned = TRAINED.into_iter().chain(LEARNED).map(|name| (Table::Comparison, name));
        let parts = LEARNED_ABLATIONS.into_iter().map(|(_, name)| (Table::Ablation, name));
        for (table, name) in learned.chain(parts) {
            rows.extend(self.lack(name).map(|reason| absent(table, name, &reason)));
        }
        if self.protocol.weights.is_none() {
            rows.push(absent(Table::Comparison, "SPAN, SAFMN++, RT4KSR", "no folder of weights was named"));
        }
        if self.simplified.is_none() {
            rows.push(absent(Table::Acceleration, SIMPLIFIED, "no simplified scene was given"));
        }
        rows
    }
}

/// Frames that `method` displays while plain native rendering beside it shows one.
fn speed(results: &Results, method: &str) -> Option<f64> {
    results.speeds.iter().find(|(name, _)| name == method)?.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_names_are_methods() {
        let ablations = ABLATIONS.into_iter().chain(LEARNED_ABLATIONS).map(|(_, name)| name);
        for name in COMPARED.into_iter().chain(NETWORKS).chain(TRAINED).chain(LEARNED).chain(ablations) {
            assert_eq!(name.parse::<MethodSpec>().map(|m| m.to_string()).as_deref(), Ok(name));
        }
    }
}

//! Weights of methods that are networks: which files, whether they are there.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3::neural::model::{Peer, Tier};
use gs3::neural::{RunError, Weights};
use gs3::{NetworkError, Networks};

use super::{Interpolation, MethodError, MethodSpec, Spatial};
use crate::network::Trained;

/// The two networks of gs3, as the headers of their weights name them.
const SUPER_SAMPLE: &str = "super_sample";
const INTERPOLATE: &str = "interpolate";

/// Checks that `folder` is one and the weights of all `methods` are there, in it or with gs3. Whether they can be used shows when the
/// method is built.
///
/// # Errors
/// [`MethodError`] of the folder, or of the first method that lacks some.
pub(crate) fn check_weights(
    methods: &[MethodSpec],
    scale: u32,
    folder: Option<&Path>,
) -> Result<(), MethodError> {
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        return Err(MethodError::WeightFolder { folder: folder.to_owned() });
    }
    for method in methods {
        if let Some(file) = method.spatial.weight_file() {
            published(*method, file, folder)?;
        }
        if let Spatial::Trained(peer) = method.spatial
            && Trained::shipped(peer, scale).is_none()
        {
            published(*method, &trained_file(peer, scale), folder)?;
        }
        for (network, tier) in parts(*method) {
            if own_file(network, tier, scale, folder).is_none() {
                shipped(*method, network, tier, scale)?;
            }
        }
    }
    Ok(())
}

/// The file of a published network's weights.
pub(super) fn published(
    method: MethodSpec,
    file: &str,
    folder: Option<&Path>,
) -> Result<PathBuf, MethodError> {
    let file = folder.ok_or(MethodError::NoWeights { method })?.join(file);
    if file.is_file() { Ok(file) } else { Err(MethodError::WeightFile { method, file }) }
}

/// The published network `peer` with weights of gs3's trainer: those in `folder`, else those that come with gs3.
pub(super) fn trained(
    method: MethodSpec,
    peer: Peer,
    scale: u32,
    folder: Option<&Path>,
) -> Result<Trained, MethodError> {
    let name = trained_file(peer, scale);
    let own = folder.map(|folder| folder.join(&name)).filter(|file| file.is_file());
    let file = match (own, Trained::shipped(peer, scale)) {
        (Some(file), _) => file,
        (None, Some(bytes)) => {
            let network =
                Weights::from_bytes(bytes).map_err(RunError::from).and_then(|w| Trained::new(peer, w));
            return network.map_err(|source| MethodError::Network { method, source: source.into() });
        }
        (None, None) => published(method, &name, folder)?,
    };
    let network = Weights::load(&file).map_err(RunError::from).and_then(|w| Trained::new(peer, w));
    network.map_err(|source| MethodError::NetworkFile { method, file, source: Box::new(source.into()) })
}

/// As `gs3 train baseline` is told to call it.
fn trained_file(peer: Peer, scale: u32) -> String {
    format!("{}_x{scale}.safetensors", peer.name())
}

/// The networks of gs3 that `method` runs.
pub(super) fn networks(
    method: MethodSpec,
    scale: u32,
    folder: Option<&Path>,
) -> Result<Networks, MethodError> {
    let mut networks = Networks::default();
    for (network, tier) in parts(method) {
        match own_file(network, tier, scale, folder) {
            Some(file) => {
                let fail = |source| {
                    let source = Box::new(source);
                    MethodError::NetworkFile { method, file: file.clone(), source }
                };
                let weights = Weights::load(&file).map_err(|e| fail(e.into()))?;
                let actual = weights.header.network.clone();
                if actual != network {
                    return Err(fail(NetworkError::Other { expected: network, actual }));
                }
                networks.add(weights).map_err(fail)?;
            }
            None => *place(&mut networks, network) = Some(shipped(method, network, tier, scale)?),
        }
    }
    Ok(networks)
}

/// The networks that `method` runs, and their tiers.
fn parts(method: MethodSpec) -> impl Iterator<Item = (&'static str, Tier)> {
    let super_sample = match method.spatial {
        Spatial::Learned(tier) => Some((SUPER_SAMPLE, tier)),
        _ => None,
    };
    let interpolate = match method.interpolation {
        Interpolation::Learned(tier) => Some((INTERPOLATE, tier)),
        _ => None,
    };
    super_sample.into_iter().chain(interpolate)
}

/// The file in `folder` that takes the place of what comes with gs3.
fn own_file(network: &str, tier: Tier, scale: u32, folder: Option<&Path>) -> Option<PathBuf> {
    let file = folder?.join(format!("{network}_{}_x{scale}.safetensors", tier.name()));
    file.is_file().then_some(file)
}

/// The weights that come with gs3.
fn shipped(
    method: MethodSpec,
    network: &'static str,
    tier: Tier,
    scale: u32,
) -> Result<Arc<Weights>, MethodError> {
    let fail = |source| MethodError::Network { method, source };
    let mut networks = Networks::shipped(scale, tier).map_err(fail)?;
    let available = || format!("{SUPER_SAMPLE} alone of {}", tier.name());
    let missing = || fail(NetworkError::NotShipped { tier: tier.name(), scale, available: available() });
    place(&mut networks, network).take().ok_or_else(missing)
}

fn place<'a>(networks: &'a mut Networks, network: &str) -> &'a mut Option<Arc<Weights>> {
    if network == INTERPOLATE { &mut networks.interpolate } else { &mut networks.super_sample }
}

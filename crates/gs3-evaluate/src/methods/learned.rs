//! Weights of methods that are networks: which files, whether they are there.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use gs3::neural::arrays::MAX_BYTES;
use gs3::neural::model::{Network, PublishedNetwork, Tier};
use gs3::neural::{RunError, WeightError, Weights};
use gs3::{NetworkError, Networks};
use gs3_files::read_within;

use super::{Interpolation, MethodError, MethodSpec, Spatial};
use crate::digest;
use crate::network::Trained;

/// Checks that `folder` is one and the weights of all `methods` are there, in it or with gs3. Whether they can be used
/// shows when the method is built.
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
    methods.iter().try_for_each(|method| sources(*method, scale, folder).map(drop))
}

/// Where weights are.
enum Source {
    File(PathBuf),
    /// With gs3.
    Shipped(Cow<'static, [u8]>),
}

/// Where all weights are that `method` reads.
fn sources(method: MethodSpec, scale: u32, folder: Option<&Path>) -> Result<Vec<Source>, MethodError> {
    let mut sources = Vec::new();
    if let Some(file) = method.spatial.weight_file() {
        sources.push(Source::File(published(method, file, folder)?));
    }
    if let Spatial::Trained(peer) = method.spatial {
        sources.push(trained_source(method, peer, scale, folder)?);
    }
    for (network, tier) in parts(method) {
        sources.push(match own_file(network, tier, scale, folder) {
            Some(file) => Source::File(file),
            None => {
                let fail = |source: WeightError| MethodError::Network { method, source: source.into() };
                let weights = shipped(method, network, tier, scale)?;
                Source::Shipped(weights.to_bytes().map_err(fail)?.into())
            }
        });
    }
    Ok(sources)
}

/// Stands for the weights that `method` reads, those that come with gs3 included: none if it reads none.
///
/// # Errors
/// [`MethodError`] if it lacks some.
pub(crate) fn weights_digest(
    method: MethodSpec,
    scale: u32,
    folder: Option<&Path>,
) -> Result<Option<u64>, MethodError> {
    let sources = sources(method, scale, folder)?;
    let of = |source: &Source| match source {
        // What cannot be read fails the method when it is built, not the others.
        Source::File(file) => digest::of_bytes(&read_within(file, MAX_BYTES).unwrap_or_default()),
        Source::Shipped(bytes) => digest::of_bytes(bytes),
    };
    Ok((!sources.is_empty()).then(|| digest::of(&sources.iter().map(of).collect::<Vec<_>>())))
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
    peer: PublishedNetwork,
    scale: u32,
    folder: Option<&Path>,
) -> Result<Trained, MethodError> {
    let network = |weights: Result<Weights, WeightError>| {
        weights.map_err(RunError::from).and_then(|weights| Trained::new(peer, weights)).map_err(Into::into)
    };
    match trained_source(method, peer, scale, folder)? {
        Source::File(file) => network(Weights::load(&file)).map_err(|source| {
            let source = Box::new(source);
            MethodError::NetworkFile { method, file, source }
        }),
        Source::Shipped(bytes) => {
            network(Weights::from_bytes(&bytes)).map_err(|source| MethodError::Network { method, source })
        }
    }
}

/// Where the weights of `peer` are. Their file has the name that the instructions for `gs3 train baseline` give it.
fn trained_source(
    method: MethodSpec,
    peer: PublishedNetwork,
    scale: u32,
    folder: Option<&Path>,
) -> Result<Source, MethodError> {
    let name = format!("{}_x{scale}.safetensors", peer.name());
    let own = folder.map(|folder| folder.join(&name)).filter(|file| file.is_file());
    Ok(match (own, Trained::shipped(peer, scale)) {
        (Some(file), _) => Source::File(file),
        (None, Some(bytes)) => Source::Shipped(bytes.into()),
        (None, None) => Source::File(published(method, &name, folder)?),
    })
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
                if actual != network.name() {
                    return Err(fail(NetworkError::Other { expected: network.name(), actual }));
                }
                let (expected, actual) = (tier.name().to_owned(), weights.header.tier.clone());
                if actual != expected {
                    return Err(fail(WeightError::Header { field: "tier", expected, actual }.into()));
                }
                networks.add(weights).map_err(fail)?;
            }
            None => *place(&mut networks, network) = Some(shipped(method, network, tier, scale)?),
        }
    }
    Ok(networks)
}

/// The networks that `method` runs, and their tiers.
fn parts(method: MethodSpec) -> impl Iterator<Item = (Network, Tier)> {
    let super_sample = match method.spatial {
        Spatial::Learned(tier) => Some((Network::SuperSample, tier)),
        _ => None,
    };
    let interpolate = match method.interpolation {
        Interpolation::Learned(tier) => Some((Network::Interpolate, tier)),
        _ => None,
    };
    super_sample.into_iter().chain(interpolate)
}

/// The file in `folder` that takes the place of what comes with gs3.
fn own_file(network: Network, tier: Tier, scale: u32, folder: Option<&Path>) -> Option<PathBuf> {
    let file = folder?.join(format!("{}_{}_x{scale}.safetensors", network.name(), tier.name()));
    file.is_file().then_some(file)
}

/// The weights that come with gs3.
fn shipped(
    method: MethodSpec,
    network: Network,
    tier: Tier,
    scale: u32,
) -> Result<Arc<Weights>, MethodError> {
    let fail = |source| MethodError::Network { method, source };
    let mut networks = Networks::shipped(scale, tier).map_err(fail)?;
    let available = || format!("{} alone of {}", Network::SuperSample.name(), tier.name());
    let missing = || fail(NetworkError::NotShipped { tier: tier.name(), scale, available: available() });
    place(&mut networks, network).take().ok_or_else(missing)
}

fn place(networks: &mut Networks, network: Network) -> &mut Option<Arc<Weights>> {
    match network {
        Network::SuperSample => &mut networks.super_sample,
        Network::Interpolate => &mut networks.interpolate,
    }
}

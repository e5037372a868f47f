//! The command line as it was given, and what is wrong with it in one line.

use std::error::Error;
use std::num::{ParseFloatError, ParseIntError};

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::parser::ValueSource;
use clap::{ArgMatches, CommandFactory, FromArgMatches};

use super::error::single_line;

/// Which options of the command were given, not left at their defaults.
#[derive(Debug)]
pub struct Given(ArgMatches);

impl Given {
    /// Whether `option` was, by its name with dashes.
    pub fn has(&self, option: &str) -> bool {
        let id = option.trim_start_matches('-').replace('-', "_");
        self.0.value_source(&id) == Some(ValueSource::CommandLine)
    }
}

/// Reads the command line of this process.
pub fn parse<Args: CommandFactory + FromArgMatches>() -> Result<(Args, Given), clap::Error> {
    let mut matches = negative_numbers(Args::command()).try_get_matches()?;
    let args = Args::from_arg_matches(&matches)?;
    while let Some((_, inner)) = matches.remove_subcommand() {
        matches = inner;
    }
    Ok((args, Given(matches)))
}

/// Negative numbers are values of options, so that their own checks say what is wrong with them: there are no options
/// of one letter that they could be.
fn negative_numbers(command: clap::Command) -> clap::Command {
    let allow = |arg: clap::Arg| match arg.get_action().takes_values() && !arg.is_positional() {
        true => arg.allow_negative_numbers(true),
        false => arg,
    };
    command.mut_args(allow).mut_subcommands(negative_numbers)
}

/// What is wrong in one line; none for help and versions, which are no errors.
pub fn complaint(error: &clap::Error) -> Option<String> {
    let line = match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => return None,
        ErrorKind::ValueValidation => unfit(error),
        ErrorKind::InvalidValue => unknown(error),
        _ => None,
    };
    Some(single_line(&line.map_or_else(|| head(error), |line| format!("error: {line}"))))
}

/// An option with a value that its parser refuses.
fn unfit(error: &clap::Error) -> Option<String> {
    let (option, value) = (option(error)?, text(error, ContextKind::InvalidValue)?);
    let source = error.source()?;
    let reason = source.to_string();
    let range = reason.strip_prefix(&format!("{value} is not in ")).and_then(|range| range.split_once(".."));
    let expected = match range {
        Some((from, "")) => format!("at least {from}"),
        Some((from, to)) => format!("{from} to {}", to.trim_start_matches('=')),
        None if source.is::<ParseIntError>() => "a whole number".to_owned(),
        None if source.is::<ParseFloatError>() => "a number".to_owned(),
        // Parsers of this program say what they found.
        None => return Some(format!("{option}: {reason}")),
    };
    Some(format!("{option}: expected {expected}, found {value}"))
}

/// An option with a value that is not in the list, or with none.
fn unknown(error: &clap::Error) -> Option<String> {
    let (option, value) = (option(error)?, text(error, ContextKind::InvalidValue)?);
    let expected = match error.get(ContextKind::ValidValue) {
        Some(ContextValue::Strings(valid)) if !valid.is_empty() => alternatives(valid),
        _ => "a value".to_owned(),
    };
    Some(format!("{option}: expected {expected}, found {}", if value.is_empty() { "none" } else { value }))
}

/// `a, b or c`.
pub fn alternatives<T: AsRef<str>>(names: &[T]) -> String {
    let names: Vec<&str> = names.iter().map(T::as_ref).collect();
    match names.split_last() {
        Some((last, [])) => (*last).to_owned(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => String::new(),
    }
}

/// Name of the option at fault, without what it takes.
fn option(error: &clap::Error) -> Option<&str> {
    let option = text(error, ContextKind::InvalidArg)?;
    Some(if option.starts_with('-') { option.split([' ', '[', '=']).next()? } else { option })
}

fn text(error: &clap::Error, kind: ContextKind) -> Option<&str> {
    match error.get(kind)? {
        ContextValue::String(text) => Some(text),
        _ => None,
    }
}

/// What clap says before it explains how the command is used.
fn head(error: &clap::Error) -> String {
    let said = error.to_string();
    let lines = said
        .lines()
        .map(str::trim)
        .take_while(|line| !["Usage:", "For more information"].iter().any(|start| line.starts_with(start)));
    lines.filter(|line| !line.is_empty()).fold(String::new(), |head, line| match line {
        _ if head.is_empty() => line.to_owned(),
        _ if line.starts_with("tip:") => format!("{head}; {line}"),
        _ => format!("{head} {line}"),
    })
}

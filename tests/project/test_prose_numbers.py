"""Every measured number in the sentences of README and docs is computed from results/ anew.

The rules stand in prose_numbers.py; a claim in README's results or in docs/results.md needs one.
"""

import math
import re

import pytest

from tests.paths import ROOT
from tests.project.prose_numbers import COMPARISONS, RULES

README, RESULTS = ROOT / "README.md", ROOT / "docs/results.md"
PAGES = [README, *sorted(ROOT.glob("docs/*.md")), ROOT / "results/README.md"]

WORDS = {
    "a half": 1 / 2, "a third": 1 / 3, "a quarter": 1 / 4, "a fifth": 1 / 5, "a sixth": 1 / 6,
    "a seventh": 1 / 7, "an eighth": 1 / 8, "a tenth": 1 / 10, "one": 1, "two": 2, "three": 3,
    "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9, "ten": 10,
}  # fmt: skip
DIGITS = r"[-−+]?\d[\d,]*(?:\.\d+)?"
NUMBER = rf"({DIGITS}|{'|'.join(WORDS)})"
UNIT = r"(?:times|%|µJ|nJ|pJ|SOPs?|MACs?|points|(?:synaptic )?operations)"
# a number before a unit, or before others that stand before it; a fraction in words
MEASURED = re.compile(
    rf"\b{DIGITS}(?:,? (?:to|and|or) {DIGITS})*\s?{UNIT}(?!\w)"
    rf"|\b(?:{'|'.join(WORDS)}) (?:to (?:{'|'.join(WORDS)}) )?(?:times|of the)\b"
    r"|\btwice\b|\b(?:half|third|quarter|fifth|sixth|seventh|eighth|tenth) (?:of|as)\b"
)


def prose(text):
    """The sentences of a page in Markdown, without code, tables, links and emphasis."""
    text = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    text = re.sub(r"^(?:    |\||#).*$", "", text, flags=re.M)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(re.sub(r"[*`]", "", text).split())


def section(text, title):
    """What stands under a heading of the second level."""
    return re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", text, re.M | re.S)[1]


def pattern(template):
    """The expression that finds a rule's piece of a sentence, and its numbers."""
    return re.compile(NUMBER.join(map(re.escape, template.split("{}"))))


def unit_of(text):
    """The unit of the last digit that counts: zeros at the end of 270 or 6,500 do not."""
    digits = text.lstrip("+-−").replace(",", "")
    whole, _, decimals = digits.partition(".")
    if decimals or int(whole) <= 100:
        return 10.0 ** -len(decimals)
    zeros = len(whole) - len(whole.rstrip("0"))
    return 10.0 ** min(zeros, len(whole) - 2)


def says(text, value):
    """Whether a number of a sentence is the value, rounded to the digits that it has."""
    if text in WORDS:
        return text == min(WORDS, key=lambda word: abs(math.log(WORDS[word] / value)))
    written = float(text.replace("−", "-").replace(",", ""))
    return abs(written - value) <= unit_of(text) / 2 * (1 + 1e-9)


def wrong(text, rules=RULES):
    """Claims whose numbers are others than results/ has: the words, and what they should say."""
    for template, compute in rules:
        for found in pattern(template).finditer(text):
            values = list(compute())
            assert len(values) == len(found.groups()), template
            if not all(map(says, found.groups(), values)):
                yield f"{found[0]!r}: now {', '.join(f'{value:.6g}' for value in values)}"


def uncovered(text, rules=RULES):
    """Sentences with a measured number that no rule computes."""
    for template, _ in rules:
        text = pattern(template).sub("…", text)
    return [each for each in re.split(r"(?<=[.:;]) ", text) if MEASURED.search(each)]


TEXTS = {str(page.relative_to(ROOT)): prose(page.read_text("utf-8")) for page in PAGES}


@pytest.mark.parametrize("page", TEXTS)
def test_the_numbers_in_a_pages_sentences_follow_from_results(page):
    assert list(wrong(TEXTS[page])) == []


@pytest.mark.parametrize("template", [template for template, _ in RULES])
def test_every_rule_belongs_to_a_sentence(template):
    """A sentence that was rewritten needs its rule rewritten; of one that went, delete the rule."""
    assert any(pattern(template).search(text) for text in TEXTS.values())


@pytest.mark.parametrize(("words", "holds"), COMPARISONS, ids=[words for words, _ in COMPARISONS])
def test_a_comparison_in_words_stands_in_a_page_and_holds(words, holds):
    assert any(words in text for text in TEXTS.values())
    assert holds()


@pytest.mark.parametrize(
    "text",
    [section(README.read_text("utf-8"), "Results"), RESULTS.read_text("utf-8")],
    ids=["README", "docs/results.md"],
)
def test_every_measured_number_in_the_results_has_a_rule(text):
    """A new claim needs a line in prose_numbers.RULES."""
    assert uncovered(prose(text)) == []


@pytest.mark.parametrize(("template", "compute"), RULES, ids=[template for template, _ in RULES])
def test_a_number_that_is_changed_in_any_sentence_is_found(template, compute):
    for found in filter(None, map(pattern(template).search, TEXTS.values())):
        for place, number in enumerate(found.groups(), 1):
            start, end = (edge - found.start() for edge in found.span(place))
            changed = found[0][:start] + other(number) + found[0][end:]
            assert list(wrong(changed, [(template, compute)])), changed


def other(number):
    """A number of the same form: half as much again, or the word after the next."""
    if number in WORDS:
        words = list(WORDS)
        return words[(words.index(number) + 2) % len(words)]
    value = 1.5 * float(number.replace("−", "-").replace(",", "")) + unit_of(number)
    return f"{value:,.{len(number.partition('.')[2])}f}"


@pytest.mark.parametrize(
    "sentence",
    [
        "It costs 4.7 times as much.",
        "Between 90 and 96 % of the steps suffice.",
        "An inference takes 0.126 µJ.",
        "It does with 48 SOPs.",
        "The small one needs a sixth of the operations.",
        "It is three to five times dearer.",
        "It needs twice the energy.",
        "It loses four points. It has 1,386 MACs.",
    ],
)
def test_a_new_claim_without_a_rule_is_found(sentence):
    assert uncovered(sentence)


@pytest.mark.parametrize(
    ("text", "value", "right"),
    [
        ("1,360", 1359.6, True), ("1,360", 1366.0, False), ("6,500", 6459.0, True),
        ("48", 48.39, True), ("48", 48.6, False), ("1,000", 960.0, True), ("1,000", 900.0, False),
        ("100", 99.4, False), ("0.126", 0.12589, True), ("−1,227", -1227.0, True),
        ("a third", 0.32, True), ("a third", 0.42, False), ("five", 4.95, True),
    ],
)  # fmt: skip
def test_a_number_says_what_it_rounds_to(text, value, right):
    assert says(text, value) is right

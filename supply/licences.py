"""The licence of an installed distribution as an SPDX expression, from what its own metadata and licence files say."""

from __future__ import annotations

from importlib.metadata import Distribution

SPDX = {
    "Apache 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD License": "BSD",
    "GNU General Public License (GPL)": "LicenseRef-GPL",
    "GNU Lesser General Public License v3 or later (LGPLv3+)": "LGPL-3.0-or-later",
    "ISC License (ISCL)": "ISC",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Public Domain": "LicenseRef-Public-Domain",
    "Python Software Foundation License": "PSF-2.0",
}
"""SPDX identifiers of the classifiers; "BSD" does not say with how many clauses, the licence file does."""


def licence_of(found: Distribution) -> str:
    """Its expression (PEP 639), else its classifiers, else its licence field, else its licence file."""
    if told := found.metadata.get("License-Expression"):
        return str(told)
    heads = [c.rpartition(" :: ")[2] for c in found.metadata.get_all("Classifier", []) if c.startswith("License ::")]
    field = str(found.metadata.get("License") or "")
    told = heads or ([field] if field and "\n" not in field else [])
    names = [SPDX.get(name, name) for name in told if name != "OSI Approved"] or ["BSD"]
    return " AND ".join(_clauses(found) if name.startswith(("BSD", "3-clause BSD")) else name for name in names)


def _clauses(found: Distribution) -> str:
    """Which BSD licence its file is; without a file nobody can tell."""
    text = " ".join(_texts(found).split()).lower()
    if "redistribution and use in source and binary forms" not in text:
        return "LicenseRef-BSD"
    named = "names of" in text or "name of" in text
    return "BSD-3-Clause" if named and "endorse" in text else "BSD-2-Clause"


def _texts(found: Distribution) -> str:
    """Licence files beside its metadata."""
    files = (file for file in found.files or () if ".dist-info" in str(file) and "licen" in str(file).lower())
    return "\n".join(file.read_text() for file in files)

"""The documentation that ships with the package: `glossary.md` explains the words of the code base."""

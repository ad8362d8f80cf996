"""What a person looks at after flying: figures, tables, verdicts."""

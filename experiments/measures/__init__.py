"""What studies measure: the cells of one recording in, a row for each out; no drawing here."""

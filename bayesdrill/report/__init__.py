"""What people look at: tables, sentences and figures of results that stand."""

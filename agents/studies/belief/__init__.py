"""The belief over the soil on drives whose soil is known: errors, coverage, widths."""

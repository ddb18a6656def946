"""Which pixels are filament."""

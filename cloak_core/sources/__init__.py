"""What makes views: bodies through the rasterizer, people in photographs through their fits; and what is behind them."""

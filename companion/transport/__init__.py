"""Links: MAVLink connection strings and the end points behind them."""

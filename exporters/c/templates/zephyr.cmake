# {{ mark }}
if(CONFIG_SPIKEDEPLOY_{{ PREFIX }})
  set(policy ${CMAKE_CURRENT_LIST_DIR}/..)
  zephyr_include_directories(${policy})
  zephyr_library_named(spikedeploy_{{ prefix }})
  zephyr_library_sources(${policy}/{{ prefix }}.c)
{% if doubles %}
  if(CONFIG_SPIKEDEPLOY_{{ PREFIX }}_DOUBLES)
    zephyr_library_sources(${policy}/codec.c)
    # a fused multiplication and addition would round otherwise
    zephyr_library_compile_options(-ffp-contract=off)
  endif()
{% if int16 %}
  if(CONFIG_SPIKEDEPLOY_{{ PREFIX }}_INT16)
    zephyr_library_sources(${policy}/codec_i16.c)
  endif()
{% endif %}
{% endif %}
{% if int16 %}
  if(CONFIG_SPIKEDEPLOY_{{ PREFIX }}_HOST)
    zephyr_library_sources(${policy}/host_i16.c)
  endif()
{% endif %}
endif()
